"""What every executed page of the site starts with: shell commands that fail end the build."""

import os
import re
import subprocess
import sys
import textwrap

import matplotlib as mpl

# Programs write what they would write to a file, neither colours nor bars.
for name in ("FORCE_COLOR", "CLICOLOR", "CLICOLOR_FORCE"):
    os.environ.pop(name, None)

# The commands of this environment, whether it is active or not.
os.environ["PATH"] = f"{os.path.dirname(sys.executable)}:{os.environ['PATH']}"

mpl.rcParams.update(
    {
        # Each stands out of white by 3 to 1 at the least, as graphics should.
        "axes.prop_cycle": mpl.cycler(
            color=["#0072B2", "#D55E00", "#117744", "#332288", "#AA4466", "#666666"]
        ),
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


def broken(line):
    """A sentence as a terminal breaks it; tables, with gaps between columns, stay as they are."""
    if len(line) <= 96 or re.search(r"\S {2,}\S", line):
        return line
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    return textwrap.fill(
        line, 96, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def write(text, whole=sys.stdout.write):
    """Write as a terminal would."""
    return whole("\n".join(map(broken, text.split("\n"))))


sys.stdout.write = write
get_ipython().system = system  # noqa: F821
del system, mpl, name
