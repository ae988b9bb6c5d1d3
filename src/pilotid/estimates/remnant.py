"""The remnant as a method saw it."""

from __future__ import annotations

from dataclasses import dataclass

from pilotid.types import FloatArray


@dataclass(frozen=True, eq=False)
class RemnantEstimate:
    """The remnant as a method saw it, inside its analysis band.

    Attributes
    ----------
    model
        Name of the noise model.
    parameters
        Its parameters by name (frequencies in rad/s).
    power_ratio
        var(n)/var(u).
    omega
        Frequencies [rad/s], shape (n,).
    density
        One-sided power spectral density [unit of u, squared, per rad/s], shape (n,).
    """

    model: str
    parameters: dict[str, float]
    power_ratio: float
    omega: FloatArray
    density: FloatArray

    @property
    def words(self) -> str:
        """It in a few words; the coefficients of a free spectrum say nothing to a reader."""
        words = f"remnant {100.0 * self.power_ratio:.1f} % of the control's power, {self.model}"
        if "frequency" in self.parameters:
            words += f" low-pass at {self.parameters['frequency']:.3g} rad/s"
        if "damping" in self.parameters:
            words += f", damping {self.parameters['damping']:.2g}"
        return words

    def to_dict(self) -> dict[str, object]:
        """Plain objects, as JSON has them."""
        return {
            "model": self.model,
            "parameters": self.parameters,
            "power_ratio": self.power_ratio,
            "omega": self.omega.tolist(),
            "density": self.density.tolist(),
        }
