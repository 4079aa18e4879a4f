"""The plants by name: what plays the machine in a simulation."""

from friction_estimator.core.registry import Registry
from friction_estimator.rig.law import Law, Plant
from friction_estimator.rig.plants_load import GearedJointPlant, LoadedPlant, PendulumPlant
from friction_estimator.rig.plants_other import MaxwellSlipPlant, StribeckPlant, TabulatedPlant
from friction_estimator.rig.plants_seal import (
    CLEAN_TAPS,
    CleanPlant,
    FilmLagPlant,
    ParallelMemoryPlant,
    RigPlant,
)

__all__ = ["CLEAN_TAPS", "PLANTS", "CleanPlant", "Law", "LoadedPlant", "Plant", "RigPlant"]

PLANTS: Registry[type[Plant]] = Registry("plant")
"""Friction laws by name; built from the theory's parameters and the recording's rate."""

PLANTS.register("rig", RigPlant)
PLANTS.register("clean", CleanPlant)
PLANTS.register("film_lag", FilmLagPlant)
PLANTS.register("parallel_memory", ParallelMemoryPlant)
PLANTS.register("maxwell_slip", MaxwellSlipPlant)
PLANTS.register("tabulated", TabulatedPlant)
PLANTS.register("stribeck", StribeckPlant)
PLANTS.register("pendulum", PendulumPlant)
PLANTS.register("geared_joint", GearedJointPlant)
