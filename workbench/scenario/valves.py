"""The entries of plants and valves in a scenario as the model's plants and valves."""

from __future__ import annotations

from workbench.model.karnopp import Karnopp
from workbench.model.plant import FOPDT, Integrating, Plant
from workbench.model.valve import Choudhury, Deadband, Directional, He, Ideal, Kano, Positional, Stenman, Valve
from workbench.scenario import schema

__all__ = ["plant_of", "valve_of"]


def plant_of(p: schema.Plant) -> Plant:
    """Return the plant of an entry. Raises `InvalidValue`."""
    if isinstance(p, schema.FopdtPlant):
        return FOPDT(p.gain, p.time_constant, p.dead_time)
    return Integrating(p.gain, p.dead_time)


def valve_of(v: schema.Valve) -> Valve:
    """Return the valve of an entry. Raises `InvalidValue` where its parameters do not go together."""
    match v:
        case schema.StenmanValve():
            return Stenman(v.d)
        case schema.HeValve():
            return He(v.fs, v.fd)
        case schema.ChoudhuryValve():
            return Choudhury(v.S, v.J)
        case schema.KanoValve():
            return Kano(v.S, v.J)
        case schema.DeadbandValve():
            return Deadband(v.b)
        case schema.DirectionalValve():
            return Directional(Choudhury(v.up.S, v.up.J), Choudhury(v.down.S, v.down.J))
        case schema.PositionalValve():
            return Positional(tuple(p.position for p in v.places), tuple(_at(p) for p in v.places))
        case schema.KarnoppValve():
            forces = v.coulomb, v.static, v.viscous
            return Karnopp(v.mass, v.spring, v.travel, *forces, v.stribeck, v.substep)
        case schema.IdealValve():
            return Ideal()


def _at(place: schema.Place) -> Stenman | Choudhury:
    """Return the friction at one place of the travel."""
    return Stenman(place.d) if isinstance(place, schema.OneParameterPlace) else Choudhury(place.S, place.J)
