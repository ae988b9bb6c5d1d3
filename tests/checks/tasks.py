"""Write the fixed tasks in datasets/tasks, as the code simulates them now."""

from __future__ import annotations

import io

import numpy as np

from pilotid.datasets import scenario_named
from pilotid.datasets.named import TASKS
from pilotid.recording.files import save_recording
from pilotid.study.run import recording_of, scenario_of, truths_of
from pilotid.support.disk import strict_json

SCENARIOS = ("nominal", "single", "target-step", "population-usual")
SEED, REPLICATIONS = 1, 5

if __name__ == "__main__":
    TASKS.mkdir(exist_ok=True)
    held = {}
    for name in SCENARIOS:
        origin = scenario_named(name)
        for replication in range(REPLICATIONS):
            scenario = scenario_of(origin, SEED, replication)
            recording = recording_of(origin, SEED, replication)
            path = TASKS / f"{name}-{replication}.npz"
            save_recording(recording, path)  # the sidecar tells the sampling interval
            with np.load(path) as archive:
                signals = {key: archive[key].astype(np.float32) for key in recording.arrays}
            stream = io.BytesIO()
            np.savez_compressed(stream, **signals)  # type: ignore[arg-type]
            path.write_bytes(stream.getvalue())
            known = truths_of(scenario)
            held[path.stem] = {
                "scenario": name,
                "replication": replication,
                "model": scenario.model.name,
                "truth": {key: truth for key, _, truth, _ in known},
                "bound": {key: float(f"{bound:.6g}") for key, *_, bound in known if bound},
            }
    (TASKS / "truth.json").write_text(strict_json(held))
    print(sum(file.stat().st_size for file in TASKS.iterdir()), "bytes")
