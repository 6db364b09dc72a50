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
# # Unknown ground
#
# Nobody measures the ground under an excavator. Three ways to live with that: find a place and gains that hold on any ground in
# question; prove it; or let the machine measure its ground by itself.
#
# Units are SI, angles in radians.

# %%
# %matplotlib inline
import numpy as np

import flexopt

machine = flexopt.load("excavator")
posture_b = [0.0448, -2.0499]
loop = {"kp": 1e4, "kv": 1e3}
ground = {"stiffness": (0.5, 2.0), "dead_time": (0.0, 0.005)}  # one factor of all springs; s

# %% [markdown]
# ## Stable on any of them?
#
# `stable_region` looks for the worst ground by gradients, then tries to prove that no unstable one is left: by branch and bound on the
# characteristic function, which excludes zero over whole boxes.

# %%
region = flexopt.stable_region(machine, posture_b, loop=loop, ranges=ground)
region

# %% [markdown]
# *Guaranteed* is what the bound covers. Where only a search speaks, it is called that.
#
# ## Seen at once
#
# Decay over gain and softness, in one posture. Points are looked at one by one: nothing is proven between them.

# %%
chart = flexopt.map_loop(
    machine, posture_b, {"kp": (1e3, 1e6), "stiffness": (0.2, 5.0)}, loop={"kv": 1e3}, points=(80, 80)
)
chart.plot()

# %% [markdown]
# ## Does it pay to move?
#
# Stay against the best places found, with the same controller over all these grounds; each confirmed by nonlinear runs. The word follows a rule that
# the result states.

# %%
answer = flexopt.verdict(flexopt.load_problem("article"), loop=loop, ranges=ground)
print(answer.word)
answer

# %%
print(answer.rule)

# %% [markdown]
# ## Let the machine measure its ground
#
# Push it, and log how the base swings while the joints are held. Here the log is made up, by another way than `identify` computes: the passive
# block of mass, stiffness and damping matrix alone, on ground that is a fifth softer than the file says, with a gyroscope's noise.

# %%
from scipy.linalg import expm

data = machine.to_dict()["base"]
truth = {"rotation": 0.8 * data["stiffness"]["rotation"]}
K = np.diag([data["stiffness"]["x"], data["stiffness"]["y"], truth["rotation"]])
D = np.diag([data["damping"]["x"], data["damping"]["y"], 6000.0])
plant = flexopt.build_plant(machine)
q = plant.rest(base=0.0, posture=posture_b, p=plant.parameter_values)["q"]
M = plant.mass(q=q, p=plant.parameter_values)["M"].full()[:3, :3]
swing = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])

t = np.arange(0.0, 6.0, 0.01)
pushed = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.002])  # rad/s
rate = np.array([(expm(swing * s) @ pushed)[5] for s in t])
log = {
    "t": t,
    "gyro_z": rate + 1e-5 * np.random.default_rng(1).standard_normal(t.size),
    "boom": np.full(t.size, posture_b[0]),
    "stick": np.full(t.size, posture_b[1]),
}

# %%
found = flexopt.identify(machine, log, unknown="base.*.rotation")
found

# %%
found.plot()

# %% [markdown]
# The identified machine goes on as any other:

# %%
value, interval = found.values["base.stiffness.rotation"], found.intervals["base.stiffness.rotation"]
print(f"{value:.5g} N m/rad, 95 % interval {interval[0]:.5g} to {interval[1]:.5g}; truth {truth['rotation']:.5g}")
flexopt.outcome(found.machine, posture_b, loop=loop)
