# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # From a posture to C
#
# The chosen posture is worth as much as the controller that runs in it. This notebook writes that controller as C, with the evidence that it
# computes what Python computes.
#
# A C compiler is used where one is found; the bundle is written without.

# %%
# %matplotlib inline
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import flexopt

machine = flexopt.load("excavator")
best = flexopt.select(machine, (0.0, 1.6), base=0.0).best.evaluation
loop = {"kp": 1e4, "kv": 1e3, "dead_time": 0.005, "filter_hz": 40.0}
flexopt.outcome(machine, best.posture, base=best.base, loop=loop)

# %% [markdown]
# ## The bundle
#
# A folder: C99 without heap, recursion or unbounded loops, a build file, a self-test, an example, a README that names every member's unit,
# frame and range.

# %%
folder = Path(tempfile.mkdtemp()) / "bundle"
exported = flexopt.export_c(
    machine, folder, parts=["kinematics", "controller", "loop"], loop=loop, posture=best.posture, base=best.base
)
print("parts:", *exported.parts)
for path in sorted(folder.rglob("*")):
    if path.is_file():
        print(f"{path.relative_to(folder)!s:42} {path.stat().st_size:8d} bytes")

# %% [markdown]
# What one sample of the controller takes and gives:

# %%
header = (folder / "include" / "excavator_control.h").read_text(encoding="utf-8")
start = header.index("excavator_loop_step_in")
print(header[header.rindex("typedef", 0, start) : start + 40])

# %% [markdown]
# ## Does it compute the same?
#
# `verify_bundle` builds it with the C compiler of this computer, runs its self-test and compares every function with Python on random
# inputs. The report has the largest error of every output.

# %%
if shutil.which("cc"):
    print(flexopt.verify_bundle(folder, inputs=100))

# %% [markdown]
# ## Run it
#
# The example of the bundle, as its README says. It shows the calls: the plain law, closed around a stand-in for the machine, an arm
# of equal inertias on rigid ground.

# %%
if shutil.which("cc") and shutil.which("make"):
    done = subprocess.run(["make", "-s", "test"], cwd=folder, capture_output=True, text=True, check=False)
    print(done.stdout[-1500:], done.stderr[-500:])

# %% [markdown]
# ## The machine's own loop in a nonlinear run
#
# `simulate` does sample by sample what the exported step of this loop does; here on the machine, whose base swings, with the gains
# above. Its end-point settles as late as the outcome says.

# %%
run = flexopt.simulate(machine, best.posture, base=best.base, loop=loop, duration=20.0)
print(run.verdict, "- end-point within", f"{1e3 * np.abs(run.error[-1]).max():.3f} mm at the end")
run.plot()
