"""Experiments: from their entries in the file to the model's values."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path as FilePath
from typing import Any

from workbench.errors import RecordError
from workbench.model.cascade import CascadeExperiment
from workbench.model.experiment import Experiment, Noise, Profile, Ramp, Series, Step
from workbench.scenario import entries, schema
from workbench.scenario.document import Path
from workbench.scenario.refusals import Refusals, one_line
from workbench.scenario.series import read_series
from workbench.scenario.units import Quantity

__all__ = ["Experiments", "one_or_many"]


@dataclass
class Experiments:
    """Reads experiments; what is refused goes to `refusals`, what was assumed of recorded series to `notes`.

    folder: where the files that are named lie.
    """

    refusals: Refusals
    notes: list[str]
    folder: FilePath

    def plain(self, given: schema.Experiment | None, path: Path = ("experiment",)) -> Experiment | None:
        """Return the experiment of a single loop."""
        if given is None:
            return None
        for name in ("primary_load", "secondary_noise"):
            if getattr(given, name) is not None:
                self.refusals.refuse((*path, name), "given for a single loop; only a cascade has such an entry")
        noise = self.noise(given.noise, (*path, "noise"))
        setpoint = self.profile(given.setpoint, (*path, "setpoint"), given.duration)
        load = self.profile(given.load, (*path, "load"), given.duration)
        return self.refusals.attempt(
            path, lambda: Experiment(given.duration, one_or_many(setpoint), one_or_many(load), noise, given.stem_offset)
        )

    def of_cascade(self, given: schema.Experiment) -> CascadeExperiment | None:
        """Return the experiment of a cascade."""
        path: Path = ("experiment",)
        noise = self.noise(given.noise, (*path, "noise"))
        inner = self.noise(given.secondary_noise, (*path, "secondary_noise"))
        parts = {
            name: tuple(self.profile(getattr(given, name), (*path, name), given.duration))
            for name in ("setpoint", "load", "primary_load")
        }
        return self.refusals.attempt(
            path,
            lambda: CascadeExperiment(
                given.duration,
                parts["setpoint"],
                parts["load"],
                noise,
                given.stem_offset,
                parts["primary_load"],
                inner,
            ),
        )

    def noise(self, given: entries.Noise | None, path: Path) -> Noise | None:
        """Return the noise of an entry."""
        return None if given is None else self.refusals.attempt(path, lambda: Noise(given.sd, given.seed))

    def profile(self, parts: list[Any] | None, path: Path, duration: float) -> list[Profile]:
        """Return the parts of a profile that can be made; `duration`, s, is the latest start."""
        found: list[Profile] = []
        for i, part in enumerate(parts or ()):
            made = self.refusals.attempt((*path, i), partial(self._part, part, (*path, i)))
            if made is None:
                continue
            begin = made.at if isinstance(made, Step) else made.start if isinstance(made, Ramp) else 0.0
            if begin > duration:
                name = "at" if isinstance(made, Step) else "start"
                what = f"{begin:g} s given; must be within the experiment's duration ({duration:g} s)"
                self.refusals.refuse((*path, i, name), what)
                continue
            found.append(made)
        return found

    def _part(self, part: object, path: Path) -> Profile | None:
        if isinstance(part, schema.StepPart):
            return Step(self._size(part.step, (*path, "step")), part.at)
        if isinstance(part, schema.RampPart):
            return Ramp(self._size(part.ramp, (*path, "ramp")), part.start, part.end)
        if isinstance(part, schema.SeriesPart):
            return Series(part.series, part.times)
        if not isinstance(part, schema.FilePart):
            return None
        source = self.folder / part.file
        try:
            series = read_series(source, part.file, part.column.strip(), part.time, part.resting_value)
        except (RecordError, OSError, ValueError) as error:
            self.refusals.refuse((*path, "file"), one_line(error))
            return None
        rest = "its first value" if part.resting_value is None else f"{part.resting_value:g}"
        self.notes.append(
            f"{path[1]}: column {part.column} of {part.file}, {len(series.values)} values as deviations from {rest}."
        )
        return series

    def _size(self, given: Quantity, path: Path) -> float:
        in_eu = {"setpoint": "a setpoint is a number in EU", "primary_load": "this load is in EU of the secondary"}
        for name, what in in_eu.items():
            if given.unit == "%" and name in path:
                self.refusals.refuse(path, f"{given.value:g} % given; {what}")
        return given.value


def one_or_many(parts: list[Profile]) -> Profile | list[Profile] | None:
    """Return the only part itself, as a script would give it."""
    return parts[0] if len(parts) == 1 else parts or None
