"""Whether what was built is all that a user needs.

The wheel must hold the files of the source tree, no more and no less, and the sdist what it takes
to build and test; the recipe of conda-forge says what the sdist says.  Then, outside the tree,
bare environments get nothing but the wheel and its dependencies and run the comparison: the newest
dependencies on each Python that is found, and the oldest that pyproject.toml allows on the oldest
Python.

Run by `nox -s build`; `-- --quick` for the oldest Python alone, three recordings.
"""

import argparse
import csv
import hashlib
import os
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from email.parser import Parser
from pathlib import Path

import yaml

TREE = Path(__file__).parents[2]
#: Where the packages of the wheel lie in the tree.
FOLDERS = {
    "pilotid/methods": TREE / "methods",
    "pilotid/datasets": TREE / "datasets",
    "pilotid": TREE / "src/pilotid",
}
PYTHONS = ("3.11", "3.12", "3.13", "3.14")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dist", type=Path)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    dist = given.dist.absolute()
    (wheel,) = dist.glob("*.whl")
    (sdist,) = dist.glob("*.tar.gz")
    check_wheel(wheel)
    check_sdist(sdist)
    check_recipe(sdist)
    oldest, *others = PYTHONS
    many = () if given.quick else ("--replications", "25")
    few = ("--replications", "3")
    compare_from(wheel, oldest, "highest", *(many or few))
    compare_from(wheel, oldest, "lowest-direct", *few)
    for python in () if given.quick else others:
        if found(python):
            compare_from(wheel, python, "highest", *few)
        else:
            print(f"Python {python} is not on this machine: not tried", flush=True)


def check_wheel(wheel: Path) -> None:
    """Stop unless the wheel holds the source tree's files and nothing else."""
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
        notes = {name.rpartition("/")[2] for name in archive.namelist() if ".dist-info/" in name}
    wanted = {
        f"{package}/{file.relative_to(folder).as_posix()}"
        for package, folder in FOLDERS.items()
        for file in tracked(folder)
    }
    if held != wanted:
        sys.exit(f"the wheel lacks {sorted(wanted - held)} and has {sorted(held - wanted)} beside")
    if missing := {"LICENSE", "METADATA", "entry_points.txt"} - notes:
        sys.exit(f"the wheel's notes lack {sorted(missing)}")
    print(f"{wheel.name}: {len(held)} files, all of the tree's", flush=True)


def check_sdist(sdist: Path) -> None:
    """Stop unless the sdist holds the packages, and their tests."""
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {
        file.relative_to(TREE).as_posix()
        for folder in (*FOLDERS.values(), TREE / "tests")
        for file in tracked(folder)
    } | {"pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "noxfile.py"}
    if missing := wanted - held:
        sys.exit(f"the sdist lacks {sorted(missing)}")
    print(f"{sdist.name}: {len(held)} files and folders", flush=True)


def check_recipe(sdist: Path) -> None:
    """Stop unless the recipe of conda-forge has the fields of the sdist."""
    recipe = yaml.safe_load((TREE / "packaging/conda-forge/recipe.yaml").read_text("utf-8"))
    with tarfile.open(sdist) as archive:
        (info,) = (
            m for m in archive.getmembers() if m.name.count("/") == 1 and "PKG-INFO" in m.name
        )
        stream = archive.extractfile(info)
        told = Parser().parsestr(stream.read().decode() if stream else "")
    needs = [n for n in told.get_all("Requires-Dist", []) if "extra ==" not in n]
    wanted = {
        "name": told["Name"],
        "version": told["Version"],
        "python": told["Requires-Python"],
        "license": told["License-Expression"],
        "summary": told["Summary"],
        "run": sorted(n.replace("matplotlib>", "matplotlib-base>") for n in needs),
        "entry points": [
            f"{name} = {place}"
            for name, place in tomllib.loads((TREE / "pyproject.toml").read_text())["project"][
                "scripts"
            ].items()
        ],
    }
    run = [need for need in recipe["requirements"]["run"] if not need.startswith("python ")]
    found = {
        "name": recipe["package"]["name"],
        "version": recipe["context"]["version"],
        "python": f">={recipe['context']['python_min']}",
        "license": recipe["about"]["license"],
        "summary": recipe["about"]["summary"],
        "run": sorted(need.replace(" ", "") for need in run),
        "entry points": recipe["build"]["python"]["entry_points"],
    }
    for field, value in wanted.items():
        if found[field] != value:
            sys.exit(f"recipe.yaml: {field} is {found[field]}, that of the sdist {value}")
    digest = hashlib.sha256(sdist.read_bytes()).hexdigest()
    print(f"recipe.yaml agrees with {sdist.name}, whose sha256 is {digest}", flush=True)


def tracked(folder: Path) -> list[Path]:
    """The files of a folder that belong to the project."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "."], cwd=folder, capture_output=True, text=True, check=True
    )
    return [folder / name for name in listed.stdout.split("\0") if name]


def found(python: str) -> bool:
    """Whether this machine has such a Python."""
    command = ["uv", "python", "find", "--no-python-downloads", python]
    return subprocess.run(command, capture_output=True, check=False).returncode == 0


def compare_from(wheel: Path, python: str, resolution: str, *options: str) -> None:
    """Install the wheel into a bare environment, away from the tree, and compare there."""
    needs = tomllib.loads((TREE / "pyproject.toml").read_text())["project"]["dependencies"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = Runs(folder)
        run("uv", "venv", "--quiet", "--no-python-downloads", "--python", python, "bare")
        install = ("uv", "pip", "install", "--quiet", "--python", "bare", "--strict")
        # What pyproject.toml asks for is "direct" only where it is asked for itself.
        run(*install, "--resolution", resolution, wheel, *needs)
        program = folder / "bare/bin/pilotid"
        version = run(program, "--version").split()[-1]
        if version != wheel.name.split("-")[1]:
            sys.exit(f"{wheel.name} says that its version is {version}")
        run(program, "compare", "--out", "compared", *options)
        with (folder / "compared/estimates.csv").open(newline="") as stream:
            rows = [row for row in csv.DictReader(stream) if row["scenario"] == "nominal"]
        usable = {row["method"] for row in rows if row["outcome"] == "converged"}
        tried = {row["method"] for row in rows}
        if usable != tried or len(tried) < 5:
            sys.exit(f"{sorted(tried - usable)} of {sorted(tried)} gave no estimate")
        if not (folder / "compared/report.html").stat().st_size:
            sys.exit("no report")
        installed = run("uv", "pip", "list", "--quiet", "--python", "bare", "--format", "freeze")
        versions = dict(line.split("==") for line in installed.split())
    names = [need.partition(">=")[0] for need in needs]
    text = ", ".join(f"{name} {versions[name]}" for name in names)
    print(f"Python {python} with {text}: {len(tried)} methods compared", flush=True)


class Runs:
    """Runs commands in a folder, with nothing of this environment to be found by Python."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
        self.environment = {**kept, "OMP_NUM_THREADS": "1"}

    def __call__(self, *command: str | Path) -> str:
        done = subprocess.run(
            list(map(str, command)),
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            sys.exit(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
        return done.stdout


if __name__ == "__main__":
    main()
