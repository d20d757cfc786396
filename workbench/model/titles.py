"""What figures and parameters are called where people read them, and in which unit they stand."""

from __future__ import annotations

__all__ = ["KPI_ROWS", "kpi_title", "within"]

# Name in Kpis, title, unit, whether less is better.
KPI_ROWS: tuple[tuple[str, str, str, bool], ...] = (
    ("mean_square_error", "Mean square error", "EU²", True),
    ("error_variance", "Error variance", "EU²", False),  # blind to a standing offset: shown, never a reason
    ("valve_travel", "Valve travel", "%", True),
    ("controller_travel", "Controller travel", "%", False),
    ("op_variance", "OP variance", "%²", False),
    ("valve_variance", "Valve variance", "%²", False),
    ("reversals", "Valve reversals", "", True),
    ("iae", "Integrated absolute error", "EU s", True),
    ("pv_sd", "Standard deviation of PV", "EU", False),
    ("overshoot", "Overshoot", "% of step", False),
    ("settling_time", "Settling time", "", True),
    ("final_error", "Error at the end", "EU", False),
    ("oscillation_index", "Oscillation index", "0 to 1", False),
    ("oscillation_period", "Oscillation period", "", False),
)
_TITLES = {name: (title, unit) for name, title, unit, _ in KPI_ROWS} | {
    "ise": ("Integrated squared error", "EU² s"),
    "objective": ("J", ""),
    "d": ("Stiction d", "%"),
    "S": ("Stick band S", "%"),
    "J": ("Slip jump J", "%"),
    "b": ("Dead band b", "%"),
    "gain": ("Gain K", "EU/%"),
    "time_constant": ("Time constant", "s"),
    "dead_time": ("Dead time", "s"),
    "fs": ("Static friction f_s", "%"),
    "fd": ("Dynamic friction f_d", "%"),
    "Kc": ("Kc", "%/EU"),
    "Ti": ("Ti", "s"),
    "Td": ("Td", "s"),
    "sample_time": ("Sample time", "s"),
    "duration": ("Duration", "s"),
    "start_objective": ("J of the start", ""),
    "nominal": ("J before rounding", ""),
    "worst": ("Worst J near by", ""),
    "share": ("Share that only repair removes", ""),
    "mse_mean": ("Mean square error, mean over draws", "EU²"),
    "mse_median": ("Mean square error, median over draws", "EU²"),
    "mse_p90": ("Mean square error, 90th percentile", "EU²"),
    "travel_mean": ("Valve travel, mean over draws", "%"),
    "travel_median": ("Valve travel, median over draws", "%"),
    "max_sensitivity": ("Ms, valve repaired", ""),
    "gain_margin": ("Gain margin", ""),
    "phase_margin": ("Phase margin", "degrees"),
    "delay_margin": ("Delay margin", "s"),
    "frequency": ("Frequency of Ms", "rad/s"),
    "period": ("Period", "s"),
    "period_range": ("Periods of all starts", "s"),
    "closed_form_period": ("Period in closed form", "s"),
    "window": ("Time needed to see it", "s"),
    "pv_peak_to_peak": ("PV peak to peak", "EU"),
    "sp_peak_to_peak": ("SP peak to peak", "EU"),
    "op_peak_to_peak": ("OP peak to peak", "%"),
    "travel_per_hour": ("Valve travel an hour", "%/h"),
    "reversals_per_hour": ("Valve reversals an hour", "1/h"),
    "amplitude": ("Amplitude of OP", "%"),
    "pv_amplitude": ("Amplitude of PV", "EU"),
    "distance": ("Least distance of the loci", ""),
    "noise_sd": ("PV about the prediction, standard deviation", "EU"),
    "slips": ("Stem moves", ""),
    "load_index": ("Load disturbances in 50 periods", ""),
    "linear_stable": ("Stable with an ideal valve", ""),
    "sp": ("SP", "EU"),
    "pv": ("PV", "EU"),
    "op": ("OP", "%"),
    "valve_position": ("Valve position", "%"),
    "dead_band_up": ("Dead band after a turn upward", "%"),
    "dead_band_down": ("Dead band after a turn downward", "%"),
    "resolution_up": ("Resolution upward", "%"),
    "resolution_down": ("Resolution downward", "%"),
    "dead_band": ("Dead band", "%"),
    "resolution": ("Resolution", "%"),
}


def kpi_title(name: str) -> tuple[str, str]:
    """Return a figure's title and unit; an unknown name stands for itself."""
    return _TITLES.get(name, (name.replace("_", " "), ""))


SYMBOLS = frozenset({"J", "Kc", "Ti", "Td", "Ms", "OP", "PV", "SP"})


def within(title: str) -> str:
    """Return a title as it stands within a sentence: its first letter small, unless it begins with a symbol."""
    return title if title.split(" ")[0].rstrip(",") in SYMBOLS else title[:1].lower() + title[1:]
