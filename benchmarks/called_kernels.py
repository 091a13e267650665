"""The kernels that usual runs call, for `accelsurf.kernels.ahead`: ``python -m benchmarks.called_kernels``.

Needed after a change of a kernel's name or arguments. Compiles everything anew, in a folder of its own: a minute.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from accelsurf import io
from accelsurf.kernels.ahead import CALLED
from accelsurf.phantoms import recipes

#: What of these commands calls: after a run from a ball, what one from a click and a correction call beyond that. The
#: latter comes first in a run, and so in the list.
COMMANDS = (
    ("segment", "ball.nii.gz", "-o", "start", "--start", "ball:0,0,0,4", "--presmooth", "1"),
    ("segment", "ball.nii.gz", "-o", "inside", "--inside", "point:0,0,0"),
    ("refine", "inside", "--outside", "point:0,0,12", "-o", "refined"),
)
#: Runs commands; prints the kernels that they compile, called by no other, command by command.
CODE = """
import json, sys
from numba.core import event
from accelsurf.cli import execute
from accelsurf.kernels.signatures import to_text

class Calls(event.Listener):
    depth, called = 0, []

    def on_start(self, event):
        of, self.depth = event.data["dispatcher"], self.depth + 1
        if self.depth == 1:
            module = of.py_func.__module__.removeprefix("accelsurf.kernels.")
            self.called.append(f"{module}.{of.py_func.__name__}: {to_text(event.data['args'])}")

    def on_end(self, event):
        self.depth -= 1

event.register("numba:compile", Calls())
lists = []
for words in json.loads(sys.argv[1]):
    code = execute([*words, "--quiet"])
    assert code == 0, (words, code)
    lists.append(list(Calls.called))
    Calls.called.clear()
print(json.dumps(lists))
"""


def main() -> None:
    """Write the list."""
    import json

    with tempfile.TemporaryDirectory() as folder:
        io.write(recipes.make(recipes.load_recipe("ball_small")).image, Path(folder) / "ball.nii.gz")
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder, "NUMBA_NUM_THREADS": "1"}
        words = [sys.executable, "-c", CODE, json.dumps(COMMANDS)]
        ended = subprocess.run(words, env=environment, cwd=folder, stdout=subprocess.PIPE, text=True, check=True)
    lists = json.loads(ended.stdout.splitlines()[-1])
    CALLED.write_text("".join(f"{line}\n" for part in reversed(lists) for line in part))
    print(f"{CALLED}: {' + '.join(str(len(part)) for part in lists)} kernels")


if __name__ == "__main__":
    main()
