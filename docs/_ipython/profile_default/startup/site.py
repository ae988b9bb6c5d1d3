"""What every executed page of the site starts with: shell commands that fail end the build."""

import os
import subprocess
import sys

import matplotlib as mpl

# Programs write what they would write to a file, neither colours nor bars.
for name in ("FORCE_COLOR", "CLICOLOR", "CLICOLOR_FORCE"):
    os.environ.pop(name, None)

# The commands of this environment, whether it is active or not.
os.environ["PATH"] = f"{os.path.dirname(sys.executable)}:{os.environ['PATH']}"

mpl.rcParams.update(
    {
        "figure.figsize": (7.2, 3.6),
        "figure.constrained_layout.use": True,
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "legend.frameon": False,
        "svg.hashsalt": "pilotid",  # the same figure is the same file
    }
)


def system(command):
    """Run a line that begins with `!`, as a shell would; a status other than 0 is an error."""
    done = subprocess.run(
        command,
        shell=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
    )
    print(done.stdout, end="")
    if done.returncode:
        raise RuntimeError(f"{command} ended with status {done.returncode}")


get_ipython().system = system  # noqa: F821
del system, mpl, name
