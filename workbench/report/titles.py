"""What figures and parameters are called in the report, and in which unit they stand."""

from __future__ import annotations

__all__ = ["KPI_ROWS", "kpi_title"]

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
}


def kpi_title(name: str) -> tuple[str, str]:
    """Return a figure's title and unit; an unknown name stands for itself."""
    return _TITLES.get(name, (name.replace("_", " "), ""))
