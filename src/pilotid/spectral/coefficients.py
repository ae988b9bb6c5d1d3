"""Fourier coefficients of a recording at its forcing lines and at the bins beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pilotid.estimate.quantities import FrequencyResponse, circular
from pilotid.model.model import PilotModel
from pilotid.recording.recording import Recording, remembered
from pilotid.recording.spectra import coefficients_at, forcing_lines, hidden_lines
from pilotid.support.types import BoolArray, ComplexArray, FloatArray, IntArray

#: Bins beside each line that tell leakage and power, and the order of the polynomial that leakage
#: follows there.
NEIGHBOURS, TREND = 16, 1
#: Adjacent lines whose scatter between runs is averaged.
POOLED = 5


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Fourier coefficients at n forcing lines and, behind them, at the bins between.

    Attributes
    ----------
    omega
        Frequencies of the lines and then of the bins [rad/s], each ascending, shape (all,).
    disturbance
        Which lines are the disturbance's, shape (n,).
    control
        Coefficients of the control, shape (runs, all).
    inputs
        Coefficients of each channel's signed input, shape (channels, runs, all).
    seen
        Coefficients of the signals that move at every line, at most two, of which the inputs
        are made; shape (signals, runs, all).
    mixing
        What turns responses to `inputs` into those to `seen`, shape (signals, channels).
    weights
        What averages runs in phase: the conjugate of each run's forcing function at the lines, of
        mean square 1 over the runs; zero in runs without the line, (runs, n).
    beside
        For each line, the indices of the bins beside it, shape (n, beside).
    trend
        Weights with which the bins beside a line give the trend there, shape (n, beside).
    detrend
        Projectors of those bins on what is no trend, over their degrees of freedom, shape
        (n, beside, beside).
    freedom
        Degrees of freedom of the power beside a line in one run.
    paths
        Responses of each channel's signed input to the control, through the loop, at the lines;
        shape (channels, n).
    """

    omega: FloatArray
    disturbance: BoolArray
    control: ComplexArray
    inputs: ComplexArray
    seen: ComplexArray
    mixing: FloatArray
    weights: ComplexArray
    beside: IntArray
    trend: FloatArray
    detrend: FloatArray
    freedom: int
    paths: ComplexArray

    @property
    def lines(self) -> int:
        """Number of lines n."""
        return int(self.disturbance.size)

    def at_lines(self, coefficients: ComplexArray) -> ComplexArray:
        """Coefficients at the lines, shape (..., n), averaged over runs in phase.

        Parameters
        ----------
        coefficients
            Shape (..., runs, n).
        """
        return np.asarray(np.mean(coefficients * self.weights, axis=-2))

    def leakage(self, residuals: ComplexArray) -> ComplexArray:
        """What transients leak to the lines, shape (..., runs, n).

        Parameters
        ----------
        residuals
            Residuals at lines and bins, shape (..., runs, all).
        """
        return np.asarray(np.einsum("nb,...nb->...n", self.trend, residuals[..., self.beside]))

    def power(self, residuals: ComplexArray, *, for_weights: bool = True) -> FloatArray:
        """Power of the remnant in the averaged coefficients at the lines, shape (n,).

        The bins beside a line tell it.  The differences between runs with that line, which a pilot
        who changes makes larger, scale it; adjacent lines share that factor, which one line
        alone would tell with few degrees of freedom.

        Parameters
        ----------
        residuals
            Residuals at lines and bins, shape (runs, all).
        for_weights
            Whether it is raised for what weights that scatter cost.
        """
        runs = len(residuals)
        freedom = np.full(self.lines, float(self.freedom))
        bins = residuals[:, self.beside]
        left = np.einsum("rnb,nbc,rnc->n", bins.conj(), self.detrend, bins).real / runs
        power = left * (1.0 + np.sum(self.trend**2, axis=1)) / runs
        # Far below what any recording resolves, it keeps weights finite without a remnant.
        least = 1e-12 * np.abs(self.at_lines(self.control[:, : self.lines])) ** 2
        power = np.maximum(power, least)
        having = self.weights != 0.0  # the runs that have each line
        free = having.sum(axis=0) - 1
        if free.any():
            noise = residuals[:, : self.lines] - self.leakage(residuals)
            noise = np.where(having, noise - self.weights.conj() * self.at_lines(noise), 0.0)
            window = np.ones(POOLED)
            ascending = np.argsort(self.omega[: self.lines], kind="stable")

            def pooled(values: FloatArray) -> FloatArray:
                return np.convolve(values[ascending], window, "same")

            share = np.sum(np.abs(noise) ** 2, axis=0) / (power * runs)
            scatter, count = pooled(share), pooled(free)
            near = POOLED * count / pooled(np.ones(self.lines))
            enough = near >= POOLED
            power[ascending[enough]] *= scatter[enough] / count[enough]
            freedom[ascending[enough]] = near[enough]
            power = np.maximum(power, least)
        # Right weights would do with freedom - 1, which makes the information right on average
        # (for complex normal residuals); estimated ones scatter, and cost as much again.
        return np.asarray(power * freedom / (freedom - 2.0) if for_weights else power)

    def residuals(self, responses: ComplexArray) -> ComplexArray:
        """Control less what channels with these responses, (channels, all), make of it."""
        return np.asarray(self.control - np.einsum("ca,cra->ra", responses, self.inputs))

    def first_residuals(self) -> ComplexArray:
        """Residuals before anything is known of the model, shape (runs, all).

        Between the lines e = -x, so that the remnant there is U - D E with D = U/E at the
        lines of the disturbance (at those of the target for a pilot without motion who
        follows a target alone); D is interpolated.
        """
        known = self.disturbance if self.disturbance.any() else ~self.disturbance
        omega = self.omega[: self.lines][known]
        reference = self.seen[0]
        leakage = np.zeros_like(self.weights)
        for _ in range(3):
            control = self.at_lines(self.control[:, : self.lines] - leakage)
            ratio = control / self.at_lines(reference[:, : self.lines])
            logarithm = interpolation(omega, self.omega) @ _logarithm(ratio[known])
            # Where the error is next to nothing at a line the ratio says nothing, however large.
            everywhere = np.exp(np.minimum(logarithm.real, 50.0) + 1j * logarithm.imag)
            residuals = self.control - everywhere * reference
            leakage = self.leakage(residuals)
        return np.asarray(residuals)

    def answered(self, residuals: ComplexArray | None = None) -> FrequencyResponse:
        """`response` of the control less what these residuals (runs, all) leak to the lines.

        None for `first_residuals`: the response before anything is known of the model.
        """
        residuals = self.first_residuals() if residuals is None else residuals
        control = self.control[:, : self.lines] - self.leakage(residuals)
        return self.response(self.at_lines(control), self.power(residuals))

    def response(self, control: ComplexArray, power: FloatArray) -> FrequencyResponse:
        """The responses of the channels that give a control at the lines.

        Parameters
        ----------
        control
            Control at the lines, averaged over runs, shape (n,).
        power
            Power of the remnant in it, shape (n,).
        """
        signed = self.at_lines(self.seen[:, :, : self.lines])
        order = np.argsort(self.omega[: self.lines], kind="stable")
        omega = self.omega[: self.lines][order]
        ratio, noise = (control / signed[0])[order], (np.sqrt(power) / np.abs(signed[0]))[order]
        if len(signed) == 1:
            return FrequencyResponse(
                omega, ratio[None], circular(np.diag(noise**2).astype(complex))
            )
        # U/E = H1 + (X/E) H2 at each line, and interpolated from the other forcing function's.
        slope, disturbance = (signed[1] / signed[0])[order], self.disturbance[order]
        weights = np.zeros((omega.size, omega.size))
        logarithms = np.zeros((2, omega.size), dtype=complex)
        bent = np.zeros((2, omega.size))
        for chosen in (disturbance, ~disturbance):
            logarithms[:, chosen] = [_logarithm(values[chosen]) for values in (ratio, slope)]
            weights[np.ix_(~chosen, chosen)] = interpolation(omega[chosen], omega[~chosen])
            bent[:, ~chosen] = bends(omega[chosen], omega[~chosen], logarithms[:, chosen])
        other_ratio, other_slope = np.exp(logarithms @ weights.T)
        second = (ratio - other_ratio) / (slope - other_slope)
        first = ratio - slope * second
        # What the remnant at each line does to both responses at every line.
        equation = np.diag(noise).astype(complex)
        others = other_ratio[:, None] * weights * (noise / ratio)
        on_second = (equation - others) / (slope - other_slope)[:, None]
        # And what interpolation may be off by, which counts as random: its phase is not known.
        off = np.hypot(bent[0] * np.abs(other_ratio), bent[1] * np.abs(second * other_slope))
        on_second = np.hstack([on_second, np.diag(off / np.abs(slope - other_slope))])
        equation = np.hstack([equation, np.zeros_like(equation)])
        on_first = equation - slope[:, None] * on_second
        # Back to the channels' own inputs.
        value, both = np.array([first, second]), np.array([on_first, on_second])
        value, both = (np.linalg.solve(self.mixing, v.reshape(2, -1)) for v in (value, both))
        both, value = both.reshape(2, omega.size, -1), value.reshape(2, -1)
        # Where runs exchange their lines, both equations of a frequency give the same responses.
        omega, once = np.unique(omega, return_index=True)
        both = both[:, once].reshape(2 * omega.size, -1)
        return FrequencyResponse(omega, value[:, once], circular(both @ both.conj().T))


@remembered
def coefficients_of(
    recording: Recording, model: PilotModel, neighbours: int, trend: int | None
) -> Coefficients:
    """Fourier coefficients of a recording's measurement window.

    Parameters
    ----------
    recording
        A recording with one or two multisines, see `pilotid.recording.spectra.forcing_lines`.
    model
        The pilot model.
    neighbours
        Bins beside each line to use.
    trend
        Order of the polynomial in frequency that transients leave beside a line; None for
        no transients.
    """
    by_signal = forcing_lines(recording)
    lines = np.concatenate(list(by_signal.values()))
    disturbance = np.concatenate([np.full(v.size, k == "fd") for k, v in by_signal.items()])
    hidden = hidden_lines(recording)
    # The nearest bins without a line are no farther than if lines filled all before them.
    reach = neighbours + lines.size + hidden.size
    close = np.unique(lines[:, None] + np.arange(-reach, reach + 1))
    between = np.setdiff1d(close[(close > 0) & (close < recording.samples // 2)], [*lines, *hidden])
    away = np.abs(between - lines[:, None])
    nearest = np.sort(np.argsort(away, axis=1, kind="stable")[:, :neighbours], axis=1)
    used, index = np.unique(nearest, return_inverse=True)
    bins = between[used]
    everywhere = np.concatenate([lines, bins])

    def transformed(signal: FloatArray) -> ComplexArray:
        window = recording.window(signal)
        return np.asarray(np.fft.rfft(window)[:, everywhere] / recording.samples)

    orders = np.arange(0 if trend is None else trend + 1)
    powers = ((between[nearest] - lines[:, None]) / neighbours)[:, :, None] ** orders
    fitting = np.linalg.pinv(powers) if orders.size else np.zeros((lines.size, 0, neighbours))
    weights = fitting[:, 0] if orders.size else np.zeros((lines.size, neighbours))
    omega = 2.0 * np.pi * everywhere / recording.duration
    beside = lines.size + index.reshape(nearest.shape)
    control = transformed(recording.u)
    inputs = np.array([c.sign * transformed(recording.input(c.on)) for c in model.channels])
    seen, mixing = inputs, np.eye(len(inputs))
    if any(c.on == "ft" for c in model.channels):
        # ft = e + x is zero at the disturbance's lines, where a ratio to it has no logarithm.
        seen = np.array([transformed(recording.e), transformed(recording.x)])
        parts = {"e": (1.0, 0.0), "x": (0.0, 1.0), "ft": (1.0, 1.0)}
        mixing = np.array([np.multiply(c.sign, parts[c.on]) for c in model.channels]).T
    return Coefficients(
        omega=omega,
        disturbance=disturbance,
        control=control,
        inputs=inputs,
        seen=seen,
        mixing=mixing,
        weights=_weights(recording, by_signal),
        beside=beside,
        trend=weights,
        detrend=(np.eye(neighbours) - powers @ fitting) / (neighbours - orders.size),
        freedom=neighbours - orders.size,
        paths=_paths(omega, beside, control, inputs),
    )


def _paths(
    omega: FloatArray, beside: IntArray, control: ComplexArray, inputs: ComplexArray
) -> ComplexArray:
    """What the loop makes of the control, from the bins beside each line.

    No forcing function is there, so that each input is the control's product with the way
    through the loop, which is known without noise, and a trend that transients leave.  Both are
    smooth in frequency once multiplied by its square, whatever integrators there are.

    Returns
    -------
    Array of shape (channels, n).
    """
    lines = len(beside)
    square = (omega[beside] / omega[:lines, None]) ** 2
    distance = omega[beside] - omega[:lines, None]
    distance = distance / np.max(np.abs(distance), axis=1, keepdims=True)
    smooth = distance[..., None] ** np.arange(3)
    trend = np.linalg.qr(smooth[..., :2]).Q

    def detrended(columns: ComplexArray) -> ComplexArray:
        """Columns at all bins beside a line in all runs, from (runs, n, beside, columns)."""
        left = columns - trend @ (trend.swapaxes(-1, -2) @ columns)
        return np.asarray(np.moveaxis(left, 0, 1).reshape(lines, -1, columns.shape[-1]))

    inverse = np.linalg.pinv(detrended(control[:, beside, None] * smooth), rcond=1e-9)
    ways = [detrended((signal[:, beside] * square)[..., None]) for signal in inputs]
    return np.array([(inverse @ way)[:, 0, 0] for way in ways])


def _weights(recording: Recording, by_signal: dict[str, IntArray]) -> ComplexArray:
    """What averages runs in phase at the lines, see `Coefficients`, (runs, n)."""
    parts = []
    for name, lines in by_signal.items():
        forcing = coefficients_at(recording, name, lines)
        if forcing is None:
            forcing = np.ones((recording.runs, lines.size), dtype=complex)
        size = np.sqrt(np.mean(np.abs(forcing) ** 2, axis=0))
        forcing[:, size == 0.0] = 1.0
        parts.append(forcing.conj() / np.where(size == 0.0, 1.0, size))
    return np.concatenate(parts, axis=1)


def interpolation(known: FloatArray, wanted: FloatArray) -> FloatArray:
    """Weights of linear interpolation over log frequency, the ends extended.

    Parameters
    ----------
    known, wanted
        Frequencies, the known ones ascending; shapes (n,) and (m,).

    Returns
    -------
    Array of shape (m, n).
    """
    x, at = np.log(known), np.log(wanted)
    left = np.clip(np.searchsorted(x, at) - 1, 0, x.size - 2)
    share = (at - x[left]) / (x[left + 1] - x[left])
    weights = np.zeros((at.size, x.size))
    rows = np.arange(at.size)
    weights[rows, left], weights[rows, left + 1] = 1.0 - share, share
    return weights


def bends(known: FloatArray, wanted: FloatArray, values: ComplexArray) -> FloatArray:
    """What `interpolation` is off by where values bend as they do nearby, shape (values, m).

    Parameters
    ----------
    known, wanted
        As for `interpolation`.
    values
        What is interpolated, shape (values, n).
    """
    x, at = np.log(known), np.log(wanted)
    slopes = np.diff(values) / np.diff(x)
    second = np.abs(np.diff(slopes)) / (x[2:] - x[:-2])  # half of the second derivative
    left = np.clip(np.searchsorted(x, at) - 1, 0, x.size - 2)
    padded = np.pad(second, ((0, 0), (1, 1)))
    larger = np.maximum(padded[:, left], padded[:, left + 1])
    return np.asarray(larger * np.abs((at - x[left]) * (x[left + 1] - at)))


def _logarithm(values: ComplexArray) -> ComplexArray:
    """Logarithm along ascending frequency, its phase without jumps."""
    return np.asarray(np.log(np.abs(values)) + 1j * np.unwrap(np.angle(values)))
