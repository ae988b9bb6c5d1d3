"""What was understood of a recording, and what is wrong with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pilotid.checks.checks import remarks
from pilotid.checks.detectors import copies_among, findings, fingerprints
from pilotid.checks.element_fit import ElementChoice, GivenElement, chosen_element
from pilotid.checks.plant import plant_of
from pilotid.recording.recording import SIGNALS, Recording
from pilotid.recording.spectra import NotMultisineError, answers, lines_of
from pilotid.support.format import Line, Table, as_text, table
from pilotid.support.numbers import rms
from pilotid.support.remarks import GRADES, Remark, gravest_first, remark_of, remarks_json

LACKING = {
    "e": "no model can be fitted",
    "x": "models with a channel on x cannot be fitted",
    "ft": "lines of a target are unknown",
    "fd": "lines of a disturbance are unknown",
}


@dataclass(frozen=True, eq=False, repr=False)
class Checked:
    """What `pilotid check` says of one recording; what takes time is worked out when asked for.

    Attributes
    ----------
    recording
        The recording.
    element
        Its controlled element, and how it is known.
    remarks
        What is wrong with it, each with a ``code`` and a ``grade``, the sentence itself as text.
    """

    recording: Recording
    element: ElementChoice
    remarks: tuple[Remark, ...]

    @cached_property
    def understood(self) -> dict[str, Any]:
        """Signals, forcing functions and their lines, rate, durations, as JSON has them.

        The keys are ``runs``, ``rate`` [Hz], ``duration`` and ``run_in`` [s] of the measurement
        window and before it; ``unscored``, the seconds at its beginning that methods in the time
        domain do not score; ``signals``, and ``missing`` with what that means; ``forcing``;
        ``element_coherence``, the mean squared coherence of x with u + fd, None if unknown; and
        ``controlled_element``, what the file says of it.

        A signal has ``name``, ``meaning``, ``origin`` (its name in the file, or what it follows
        from), ``unit``, and ``rms``, ``smallest`` and ``largest`` over the window of all runs.

        A forcing function has ``name``, ``lines`` (multiples of ``base``, 2 pi / T of the window in
        rad/s) with ``lowest`` and ``highest`` [rad/s]; ``given``, whether the file names the lines;
        ``answered``, at how many of them the control stands out of its noise, and the median
        ``coherence`` there, None where unknown; ``why`` there are no lines, empty if there are.
        """
        recording = self.recording
        plant = plant_of(recording)
        run_in = recording.run_in * recording.dt
        return {
            "runs": recording.runs,
            "rate": 1.0 / recording.dt,
            "duration": recording.duration,
            "run_in": run_in,
            "unscored": max(0.0, recording.lead_in - run_in),
            "signals": [_signal_facts(recording, name) for name in recording.signals],
            "missing": {n: why for n, why in LACKING.items() if n not in recording.signals},
            "forcing": [
                _forcing_facts(recording, name)
                for name in ("ft", "fd")
                if getattr(recording, name) is not None or name in recording.lines
            ],
            "element_coherence": None if plant is None else plant.mean_coherence,
            "controlled_element": recording.controlled_element,
        }

    def to_dict(self) -> dict[str, Any]:
        """Plain objects, in the form that `pilotid check --json` writes."""
        return {
            "recording": {**self.recording.to_dict(), **remarks_json(self.remarks)},
            "understood": {
                **self.understood,
                "recorder": [asdict(fault) for fault in findings(self.recording)],
                "element": self.element.words,
            },
            **remarks_json(self.remarks),
        }

    def blocks(self) -> list[str | Line | Table]:
        """What the terminal shows."""
        facts = self.understood
        titles = ("signal", "what it is", "from", "unit", "rms", "smallest", "largest")
        rows = [tuple(signal.values()) for signal in facts["signals"]]
        signals = table(rows, "", titles, dict.fromkeys(titles[4:], "{:.4g}".format))
        lines = [*_lines(facts), f"controlled element: {self.element.words}"]
        lines += [f"recorder: {f.sentence}" for f in findings(self.recording) if f.grade == "note"]
        return [
            Line(self.recording.description, "heading"),
            signals,
            *lines,
            *(Line(remark.line("recording"), "warning") for remark in self.remarks),
            *([] if self.remarks else ["nothing is wrong with the signals"]),
        ]

    @property
    def brief(self) -> Line:
        """One line, with the codes of the remarks."""
        remarks = gravest_first(self.remarks)
        codes = {g: dict.fromkeys(r.code for r in remarks if r.grade == g) for g in GRADES}
        flags = [f"{grade}: {', '.join(kind)}" for grade, kind in codes.items() if kind] or ["ok"]
        recording, element = self.recording, self.element.element
        size = f"{recording.runs} x {recording.duration:.4g} s, {' '.join(recording.signals)}"
        name = element.name if element else "element unknown"
        line = f"{recording.source}: {size}, {name}; {'; '.join(flags)}"
        return Line(line, "warning" if codes["wrong"] or codes["doubt"] else "")

    def __repr__(self) -> str:
        return as_text(*self.blocks())


def _signal_facts(recording: Recording, name: str) -> dict[str, Any]:
    window = recording.window(recording.input(name))
    return {
        "name": name,
        "meaning": SIGNALS.get(name, "extra signal"),
        "origin": recording.origin.get(name, name),
        "unit": recording.units.get(name, ""),
        "rms": rms(window),
        "smallest": float(window.min()),
        "largest": float(window.max()),
    }


def _forcing_facts(recording: Recording, name: str) -> dict[str, Any]:
    base = 2.0 * np.pi / recording.duration
    answered, coherence = answers(recording).get(name, (None, None))
    lines, why = [], "it does not move"
    try:
        lines = lines_of(recording, name).tolist()
    except NotMultisineError as error:
        why = str(error)
    return {
        "name": name,
        "lines": lines,
        "base": base,
        "lowest": lines[0] * base if lines else None,
        "highest": lines[-1] * base if lines else None,
        "given": name in recording.lines,
        "answered": answered,
        "coherence": coherence,
        "why": "" if lines else why,
    }


def check_all(
    recordings: Sequence[Recording],
    element: GivenElement = None,
) -> list[Checked]:
    """Check recordings, also for copies of one another.

    Parameters
    ----------
    recordings
        The recordings.
    element
        The controlled element, or its text, to compare with what is seen.
    """
    choices = [chosen_element(recording, element) for recording in recordings]
    copies = copies_among([r.source for r in recordings], [fingerprints(r) for r in recordings])
    return [
        Checked(
            recording,
            choice,
            tuple(map(remark_of, (*copies.get(n, ()), *remarks(recording), *choice.remarks))),
        )
        for n, (recording, choice) in enumerate(zip(recordings, choices, strict=True))
    ]


def summary_of(every: Sequence[Checked]) -> str:
    """How many recordings are sound, and how many have which remark."""
    grades = [{remark.code: remark.grade for remark in checked.remarks} for checked in every]
    bad = [checked for checked in grades if set(checked.values()) & {"wrong", "doubt"}]
    words = f"{len(every)} recordings, {len(every) - len(bad)} without anything wrong or in doubt"
    counts = Counter(pair for codes in grades for pair in codes.items())
    kinds = sorted(counts.items(), key=lambda kind: GRADES.index(kind[0][1]))
    told = ", ".join(f"{code} ({grade}) {count}" for (code, grade), count in kinds)
    return f"{words}: {told}" if told else words


def _lines(facts: dict[str, Any]) -> list[str]:
    lines = [_forcing(forcing) for forcing in facts["forcing"]]
    lines += [f"no {name}: {why}" for name, why in facts["missing"].items()]
    if facts["unscored"]:
        lines.append(
            f"methods in the time domain do not score the first {facts['unscored']:.3g} s of the "
            "window, for want of a longer run-in (--lead-in)"
        )
    return lines


def _forcing(forcing: dict[str, Any]) -> str:
    lines = forcing["lines"]
    if not lines:
        return f"{forcing['name']}: no lines: {forcing['why']}"
    words = (
        f"{forcing['name']}: {len(lines)} lines {'given' if forcing['given'] else 'found'}, "
        f"{lines[0]} to {lines[-1]} times {forcing['base']:.4g} rad/s "
        f"({forcing['lowest']:.3g} to {forcing['highest']:.3g} rad/s)"
    )
    if forcing["answered"] is not None:
        words += (
            f"; u stands out of its noise at {forcing['answered']} of them (coherence "
            f"{forcing['coherence']:.2f} in the median)"
        )
    return words
