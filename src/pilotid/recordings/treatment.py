"""What a user may have done to a recording before it is identified."""

from __future__ import annotations

from dataclasses import replace

from pilotid.recordings.recording import Recording


def detrended(recording: Recording) -> Recording:
    """The recording with a straight line taken out of the control of each run.

    The line is that of least squares over the measurement window.  It takes with it what the
    pilot himself did so slowly; `Recording.treatment` tells what was taken.
    """
    time = recording.time
    inside = time[recording.run_in :]
    window = recording.window(recording.u)
    centred = inside - inside.mean()
    slope = (window @ centred) / float(centred @ centred)
    mean = window.mean(axis=1)
    line = mean[:, None] + slope[:, None] * (time - inside.mean())
    gained = ", ".join(f"{s * recording.duration:.3g}" for s in slope)
    where = "run" if recording.runs == 1 else "runs"
    words = (
        f"a straight line was taken out of u, which gained {gained} over the {where} and was "
        f"{', '.join(f'{m:.3g}' for m in mean)} in the mean"
    )
    return replace(recording, u=recording.u - line, treatment=(*recording.treatment, words))
