"""The project's chores; `nox --list` shows them.

Each makes its own environment.  What follows `--` goes to the tool that it runs.
"""

import os
import shutil
from pathlib import Path

import nox

nox.options.default_venv_backend = "uv|virtualenv"
nox.options.sessions = ["tests", "lint", "types"]
nox.options.reuse_existing_virtualenvs = True

# Sessions start Python hundreds of times; where bytecode is switched off, each process compiles
# all that it imports, which takes longer than what it is started for.  What is written goes to
# the environments of the sessions and to folders that git ignores.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

PROJECT = nox.project.load_toml("pyproject.toml")
SOURCES = ("src/pilotid", "methods", "datasets", "tests", "docs", "noxfile.py")


def groups(*names: str) -> list[str]:
    return nox.project.dependency_groups(PROJECT, *names)


@nox.session
def tests(session: nox.Session) -> None:
    """Run the everyday tests on two processes; `-- --all` runs the long ones too."""
    run_tests(session)


@nox.session(python=["3.12", "3.13", "3.14"], download_python="never")
def newer(session: nox.Session) -> None:
    """Run the everyday tests on newer versions of Python; those that are not there are skipped."""
    run_tests(session)


def run_tests(session: nox.Session) -> None:
    session.install("-e", ".", *groups("tests"))
    part = () if "--all" in session.posargs else ("-m", "not long")
    session.run(
        "pytest",
        *("-n", "2", "--dist", "worksteal", "--ignore=tests/benchmarks", *part),
        *(option for option in session.posargs if option != "--all"),
        env={"OMP_NUM_THREADS": "1"},
    )


@nox.session
def portability(session: nox.Session) -> None:
    """Run the tests as on other processors, with 1 and 2 threads; `-- --quick` for a part."""
    session.install("-e", ".", *groups("tests"))
    session.run("python", "tests/checks/portability.py", *session.posargs)


@nox.session
def compare(session: nox.Session) -> None:
    """Compare the methods on simulated recordings; results go to results/compare."""
    session.install("-e", ".")
    session.run("pilotid", "compare", *session.posargs)


@nox.session
def bench(session: nox.Session) -> None:
    """Time the methods; `-- --method F.py:X` times yours as well."""
    session.install("-e", ".", *groups("tests"))
    session.run("pytest", "tests/benchmarks", *session.posargs, env={"OMP_NUM_THREADS": "1"})


@nox.session
def check(session: nox.Session) -> None:
    """Long comparisons: `-- sbc`, `-- remarks`, ...; without a name it lists them."""
    scripts = {
        "front": "front.py",
        "sbc": "sbc.py",
        "posteriors": "posteriors.py",
        "remarks": "remarks.py",
        "published": "published.py",
        "recorder": "recorder.py",
        "experiment": "experiment.py",
        "tasks": "tasks.py",
        "reference": "reference.py",
    }
    names = [name for name in session.posargs[:1] if name in scripts]
    if not names:
        session.error(f"name one of {', '.join(scripts)}, then its options")
    session.install("-e", ".", "threadpoolctl>=3")
    script = f"tests/checks/{scripts[names[0]]}"
    session.run("python", script, *session.posargs[1:], env={"OMP_NUM_THREADS": "1"})


@nox.session
def docs(session: nox.Session) -> None:
    """Build the site in docs/_build/html; `-- --links` asks whether external links answer."""
    session.install("-e", ".", *groups("docs"))
    links = "--links" in session.posargs
    options = [option for option in session.posargs if option != "--links"]
    builder = "linkcheck" if links else "html"
    if links:  # what pages print holds no links
        options += ["-D", "nb_execution_mode=off"]
        options += ["-D", "suppress_warnings=myst-nb.lexer"]  # which only executed pages have
    session.run(
        *("sphinx-build", "-W", "--keep-going", "-n", "-j", "8", "-b", builder),
        *("docs", f"docs/_build/{builder}", *options),
    )


@nox.session
def lint(session: nox.Session) -> None:
    """Check style, format and spelling."""
    session.install(*groups("lint"))
    session.run("codespell")
    session.run("ruff", "check", *SOURCES)
    session.run("ruff", "format", "--check", *SOURCES)


@nox.session
def types(session: nox.Session) -> None:
    """Check types."""
    # Only a strict editable install shows mypy the packages that package-dir maps.
    session.install("-e", ".", "--config-settings", "editable_mode=strict", *groups("types"))
    session.run("mypy", "-p", "pilotid", *session.posargs)


@nox.session
def fuzz(session: nox.Session) -> None:
    """Read recordings that are changed at random, 20,000 of each kind."""
    session.install("-e", ".", *groups("tests"))
    env = {"OMP_NUM_THREADS": "1", "PILOTID_FUZZ": "20000"}
    session.run("pytest", "tests/test_fuzz.py", *session.posargs, env=env)


@nox.session
def release(session: nox.Session) -> None:
    """Check that a release can be tagged: versions, dates, citation, paper; then build and docs."""
    session.notify("build")
    session.notify("docs")
    session.install(*groups("release"))
    session.run("python", "tests/checks/release.py", "--pdf", "paper/paper.pdf")


@nox.session
def build(session: nox.Session) -> None:
    """Build sdist and wheel, and compare the methods from the wheel alone in bare environments."""
    session.install(*groups("build"))
    dist = Path("dist").absolute()
    shutil.rmtree(dist, ignore_errors=True)
    # The wheel is made from the sdist, so that neither lacks what the other has.
    making = ("python", "-m", "build", "--installer", "uv", "--outdir", str(dist))
    session.run(*making, silent=True)
    session.run("twine", "check", "--strict", *map(str, sorted(dist.iterdir())))
    session.run("python", "tests/checks/built.py", str(dist), *session.posargs)
