"""What the base's static curve is made of at the points of the tables of dynamic regressors: no fit changes it."""

from functools import cached_property

import numpy as np

from friction_estimator.core.model.theory import TheoryCurve
from friction_estimator.core.sample import Floats
from friction_estimator.diagnosis.odd_curve import OddCurve
from friction_estimator.effects.axis import VelocityAxis
from friction_estimator.effects.extension import theory_parts, theory_sign
from friction_estimator.effects.reference import VELOCITIES, Reference, table


class StaticGrid:
    """Splines and theory over velocity and pressure, at one temperature; tabulated once, where they are asked for.

    Parameters
    ----------
    curve : the splines. theory : the theoretical curve, or None. axis : of the velocities.

    Attributes
    ----------
    pressures_Pa : (nodes,), gauge. temperature_degC : of the oil.
    """

    def __init__(
        self,
        curve: OddCurve,
        theory: TheoryCurve | None,
        axis: VelocityAxis,
        pressures_Pa: Floats,
        temperature_degC: float,
    ) -> None:
        self._curve, self._theory, self._axis = curve, theory, axis
        self.pressures_Pa, self.temperature_degC = pressures_Pa, temperature_degC

    @cached_property
    def _splines(self) -> Floats:
        """The splines, (VELOCITIES, count)."""
        return self._curve(self._axis.velocities(VELOCITIES))

    @cached_property
    def _parts(self) -> tuple[Floats | None, ...]:
        """The theory's viscous derivative, its boundary part and all of it, (nodes, VELOCITIES) each where known."""
        surfaces = theory_parts(self._theory, 1.0, self.temperature_degC)
        return tuple(None if one is None else table(one, self._axis, self.pressures_Pa) for one in surfaces)

    def reference(
        self, weights: Floats | None, theory_gain: float, lead: float, sign_velocity_m_s: float, taps: Floats | None
    ) -> Reference:
        """Return the tables of lead (theory_gain theory + splines weights), and of the theory's parts in it.

        Parameters
        ----------
        weights : of the splines, (count,), or None without them. lead : gain of the FIR behind the static force, whose
            `taps` these are; None without one.
        """
        shape = self.pressures_Pa.size, VELOCITIES
        curve = np.zeros(VELOCITIES) if weights is None else self._splines @ weights
        force = np.broadcast_to(curve, shape)
        viscous, boundary, whole = self._parts
        if whole is not None:
            force = force + theory_gain * whole
        # A film is sought in all of the force where the theory does not say what of it is a film's.
        theory = None if boundary is None else whole

        def scaled(part: Floats | None) -> Floats | None:
            return None if part is None else part * (theory_gain * lead)

        parts = scaled(viscous), scaled(boundary), scaled(theory)
        signs = sign_velocity_m_s, taps, theory_sign(self._theory)
        return Reference.of((force * lead, *parts), self._axis, self.pressures_Pa, *signs)
