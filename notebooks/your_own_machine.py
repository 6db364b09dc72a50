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
# # Your own machine
#
# From a data sheet to a posture: a forestry crane on a trailer, whose springs nobody has measured. Its first swing was counted,
# though: 1.4 Hz, dying away by half in four swings.
#
# Units are SI, angles in radians, points in the inertial frame.

# %%
# %matplotlib inline
import math
import tempfile
from pathlib import Path

import numpy as np

import flexopt

folder = Path(tempfile.mkdtemp())

# %% [markdown]
# ## The file
#
# A machine is a file: bodies in order, their lengths, masses, centres of mass and inertias, and what gives. Centres of mass
# lie `com` metres along a link. Here is one with three joints; the tables of all keys are in the documentation, and `flexopt new`
# asks for these numbers one by one.

# %%
text = """
name = "forest-crane"
[base]
length = 1.9             # m, ground to the first joint
com = 0.8
mass = 3800.0            # kg
inertia = 2600.0         # kg m²
rest_angle = 1.5707963   # rad: it stands upright
stiffness = { rotation = 8e5 }     # N m/rad; a first guess
damping = { rotation = 3e3 }       # N m s/rad
[[links]]
name = "lift"
length = 3.4
com = 1.5
mass = 420.0
inertia = 410.0
limits = [-1.7, 0.9]     # rad
[[links]]
name = "knuckle"
length = 2.6
com = 1.2
mass = 260.0
inertia = 150.0
limits = [-2.7, 0.2]
[[links]]
name = "grapple"
length = 0.9
com = 0.5
mass = 180.0
inertia = 14.0
limits = [-2.2, 2.2]
"""
file = folder / "forest-crane.toml"
file.write_text(text, encoding="utf-8")
machine = flexopt.load(file)
machine

# %% [markdown]
# ## Slips are told
#
# All faults come in one message, with field, value, unit and range. What is allowed but hardly meant is a warning: here the stiffness
# was given in kN m/rad.

# %%
try:
    flexopt.machine_from_dict(machine.to_dict() | {"gravity": "down", "weight": 3})
except flexopt.ModelError as error:
    print(error)

wrong = folder / "slip.toml"
wrong.write_text(text.replace("rotation = 8e5", "rotation = 800.0"), encoding="utf-8")
print(flexopt.check(wrong))

# %% [markdown]
# ## Springs from what was counted
#
# Who counts a swing holds the arm. Then the base alone turns, with all that it carries: $M \ddot\varphi + D \dot\varphi + K \varphi = 0$,
# $M$ the inertia about the ground point in that posture, so that $K = M \omega^2$. The measures have the joints free, as drives that
# give torques leave them: there the same spring swings faster. `flexopt new --frequency` takes the same path.

# %%
held = [-1.1, -1.3, -0.6]  # how the arm was held when the swing was counted
omega, ratio = 2 * math.pi * 1.4, math.log(2) / (2 * math.pi * 4)  # half in four swings

plant = flexopt.build_plant(machine)
p = plant.parameter_values
carried = float(plant.mass(plant.rest([0.0], held, p), [0.0], p)[0, 0])
stiffness, damping = carried * omega**2, 2 * ratio * omega * carried

data = machine.to_dict()
ground = {"stiffness": {"rotation": stiffness}, "damping": {"rotation": damping}}
machine = flexopt.machine_from_dict(data | {"base": data["base"] | ground})
here = flexopt.evaluate(machine, held)
print(f"{carried:.4g} kg m²: stiffness {stiffness:.4g} N m/rad, damping {damping:.4g} N m s/rad")
here

# %% [markdown]
# ## Is this posture good, and why?

# %%
flexopt.explain(machine, held)

# %% [markdown]
# ## Where should it stand for this log?
#
# The grapple is at a log; the trailer may roll along. The grapple shall hang steeply, the joints stay off their ends.

# %%
target = here.end_point
selection = flexopt.select(
    machine, target, base=0.0, posture=held, constraints={"joint_margin": 0.1, "tool_angle": [-2.6, -0.6]}
)
selection

# %%
selection.plot()

# %% [markdown]
# ## Does it pay to move?
#
# With the controller that the crane has, over ground that may be half or twice as stiff as what was counted, and 10 ms more dead time than
# thought:

# %%
answer = flexopt.verdict(
    selection,
    loop={"kp": 2e4, "kv": 4e3, "dead_time": 0.01},
    ranges={"stiffness": (0.5, 2.0), "dead_time": (0.01, 0.02)},
)
print(answer.word)
answer

# %% [markdown]
# ## Keep it
#
# A machine writes itself as data; the file with the numbers found is the one to keep.

# %%
import json

kept = folder / "forest-crane.json"
kept.write_text(json.dumps(machine.to_dict()), encoding="utf-8")
again = flexopt.machine_from_dict(json.loads(kept.read_text(encoding="utf-8")))
print(np.array_equal(flexopt.evaluate(again, held).w, here.w))
