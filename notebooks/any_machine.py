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
# # Any machine
#
# The excavator of the article moves in a plane and has two joints. Here a crawler excavator of 22 t does the same in space:
# slew, boom, stick and bucket, driven by cylinders, on tracks that give in all six directions. It comes from a URDF file
# and a machine file around it, and takes the same calls.
#
# Units are SI, angles in radians, points in the inertial frame; placements are x, y and yaw of the tracks.

# %%
# %matplotlib inline
import numpy as np
from matplotlib.figure import Figure

import flexopt

machine = flexopt.load("slewing-excavator")
plant = flexopt.build_plant(machine)
print(machine)
print(plant)

# %% [markdown]
# ## What its base does
#
# A load of 1 t hangs at the teeth, far out. Six modes of the tracks on the soil, from 4.5 Hz up; what feedback at the teeth
# would do to each is told by $w_i = \lambda_{\min}(R_i + R_i^\mathsf{T}) \le 0$, and 0 would be harmless.

# %%
here = [0.0, 0.0, 0.0]  # m, m, rad
held = [0.2, 0.4, -0.7, -0.5]  # slew, boom, stick, bucket, rad
now = flexopt.evaluate(machine, held, base=here)
target = now.end_point
now

# %% [markdown]
# Mode 1, in which the whole machine rocks below the stretched arm, is the worst by far.
#
# ## Where to stand instead
#
# The same load at the same point, and what the site asks for: the centre of the tracks stays 3 m off the pit below
# the load, the machine off a tank and a hut, every body above the ground, the centre of mass well inside the tracks, cylinders at 80 % of their force at most, the
# bucket not tipped. There are 4 joints and 3 coordinates of the placement for 3 task rows; `travel` prefers, among equals,
# what is near.

# %%
x, y = target[:2]
constraints = {
    "joint_margin": 0.05,  # rad
    "tip_over_margin": 0.3,  # m
    "holding": 0.8,
    "tool_angle": [-2.0, 0.5],  # rad
    "keep_out": [[[x - 3, y - 3], [x + 3, y - 3], [x + 3, y + 3], [x - 3, y + 3]]],
    "clearance": {
        "distance": 0.2,  # m
        "ground": 0.0,
        "obstacles": [
            {
                "name": "tank",
                "kind": "sphere",
                "center": [5.0, 7.0, 1.5],
                "radius": 1.5,
            },
            {
                "name": "hut",
                "kind": "box",
                "center": [4.0, -4.5, 1.5],
                "size": [2.5, 4.0, 3.0],
                "yaw": 0.3,
            },
        ],
    },
    "travel": {"cost": 1e-3},
}
even = {"objective": "V", "weights": [1.0] * 6}  # V = w_1 + … + w_6
selection = flexopt.select(machine, target, base=here, posture=held, constraints=constraints, **even)
selection

# %%
selection.plot()

# %% [markdown]
# Every candidate was checked again by functions that the solver did not use. These rows are nearest to their bounds in the
# first:

# %%
best = selection.best.evaluation
rows = {
    name: (c.value, min(c.value - c.lower, c.upper - c.value), c.unit) for name, c in selection.best.constraints.items()
}
for name in sorted((n for n in rows if rows[n][2] == "m"), key=lambda n: rows[n][1])[:4]:
    value, room, unit = rows[name]
    print(f"{name}: {value:.3f} {unit}, {room:.3f} {unit} to spare")
for cylinder in best.cylinders:
    print(cylinder)

# %% [markdown]
# ## The same controller in both places
#
# The shipped soil damps its modes by 5 % of critical and more, and swallows whatever feedback does. On hard ground a twentieth of
# that is left. The dictionary of a machine is the way to such variants.

# %%
data = machine.to_dict()
for body in data["bodies"]:
    if body["joint"].get("passive"):
        body["joint"]["damping"] *= 0.05
hard = flexopt.tree_from_dict(data | {"name": "slewing-excavator on hard ground"})

gains = {
    "kp": 1.2e6,
    "kv": 3e5,
    "nullspace_damping": 1e5,
    "offset": [0.01, 0.01, -0.01, 0.01],
}
runs = {}
for ground, one in (("soft soil", machine), ("hard ground", hard)):
    for place, e in (("present", now), ("chosen", best)):
        loop = flexopt.sampled_loop(one, e.posture, base=e.base, **gains)
        run = runs[f"{place}, {ground}"] = flexopt.simulate(one, e.posture, base=e.base, duration=30.0, **gains)
        print(f"{ground}, {place}: {run.verdict} at {run.growth_rate:+.3f}/s; linear loop {loop.growth_rate:+.3f}/s")

# %%
figure = Figure(figsize=(8.0, 3.2), layout="constrained")
axes = figure.add_subplot()
k = plant.coordinates.index("base.pitch")
for place, color in (("present", "#3b6ea5"), ("chosen", "#d95f02")):
    run = runs[f"{place}, hard ground"]
    axes.plot(
        run.time,
        1e3 * run.deflection[:, k],
        color=color,
        linewidth=0.6,
        label=f"{place}: {run.verdict}",
    )
axes.set_xlabel("time, s")
axes.set_ylabel("pitch of the tracks, mrad")
axes.legend(loc="upper left")
figure

# %% [markdown]
# ## Around the target
#
# Where else could it stand? Over all placements that reach, yaw as chosen, the joints followed from point to point from those
# chosen. Pit, tank and hut are left aside here.

# %%
chart = flexopt.map_workspace(
    machine,
    over="base",
    end_point=target,
    base=best.base,
    posture=best.posture,
    points=(40, 40),
    epsilon_max=False,
)
print(chart)

# %%
worth = chart.dataset["w"].sum("mode", skipna=False)
figure = Figure(figsize=(6.4, 5.2), layout="constrained")
axes = figure.add_subplot()
up, across = (chart.array(name) for name in chart.axes)
image = axes.pcolormesh(across, up, np.log10(-worth), cmap="viridis_r", shading="nearest")
figure.colorbar(image, label="log10 of −V, V in 1/(kg m²): yellow is best")
axes.plot(*target[:2], "+", color="black", markersize=14, label="target")
axes.plot(*now.base[:2], "s", color="#3b6ea5", markeredgecolor="white", label="present")
axes.plot(
    *best.base[:2],
    "*",
    color="#d95f02",
    markeredgecolor="black",
    markersize=15,
    label="chosen",
)
axes.set_xlabel("x of the tracks, m")
axes.set_ylabel("y of the tracks, m")
axes.set_aspect("equal")
axes.legend(loc="upper left")
figure

# %% [markdown]
# ## One stand for a trench, or a way along it
#
# Five points along a trench. `select_stand` looks for the one placement from which the worst of them is best; `plan_base` lets
# the tracks creep along, without turning, while the teeth go from the first to the last.

# %%
trench = [[7.0, y, 0.5] for y in np.linspace(-4.0, 4.0, 5)]
site = {
    "keep_out": [[[4.4, -15.0], [9.6, -15.0], [9.6, 15.0], [4.4, 15.0]]],
    "tip_over_margin": 0.3,
    "holding": 0.8,
}
stand = flexopt.select_stand(machine, trench, constraints=site, **even)
creep = {
    "duration": 40.0,
    "max_base_rate": [0.25, 0.25, 0.0],
    "seed": 1,
}  # s; m/s, m/s, rad/s
plan = flexopt.plan_base(machine, trench, constraints=site, **creep, **even)
print(stand, plan, sep="\n\n")

# %%
plan.plot()

# %% [markdown]
# The plan is a promise at rest and for small motions; the closed loop on hard ground is the proof, tracks creeping and teeth on
# their line.

# %%
paths = {"base_path": plan.base_path, "target_path": plan.target_path}
print(flexopt.simulate(hard, plan.posture[0], base=plan.base[0], duration=60.0, **paths, **gains))

# %% [markdown]
# ## What the operator's levers see
#
# Cylinders turn joint rates into lever strokes, by lever arms that change with the posture. The teeth are pulled to the machine at
# 1.5 m/s, level, from the chosen posture: $\dot q = J_v^+ \dot r$ at each step.

# %%
hydraulics = flexopt.build_hydraulics(machine)
p = plant.parameter_values
towards = np.append(best.base[:2] - target[:2], 0.0)
velocity = 1.5 * towards / np.linalg.norm(towards)  # m/s
posture, times, levers = best.posture.copy(), np.arange(0.0, 2.0, 0.02), []
for _ in times:
    q = plant.rest(base=best.base, posture=posture, p=p)["q"]
    rates = np.linalg.pinv(plant.rigid_jacobian(q=q, base=best.base, p=p)["Jv"].full()) @ velocity
    levers.append(hydraulics.lever(posture=posture, rates=rates, p=p)["lever"].full().ravel())
    posture = posture + 0.02 * rates

figure = Figure(figsize=(8.0, 3.2), layout="constrained")
axes = figure.add_subplot()
axes.plot(times, np.array(levers), label=machine.joints)
axes.axhspan(-1, 1, color="0.95", zorder=0)
axes.set_xlabel("time, s")
axes.set_ylabel("lever, 1 is full")
axes.set_ylim(-0.1, 1.1)
axes.legend(loc="upper right", ncols=4)
figure

# %% [markdown]
# At twice the speed the stick's lever would have to go beyond its end. `lever_map("uniform")` then slows all joints alike, so that
# the teeth keep their direction: the rates change by one factor, the levers by one of what they are beyond their dead band. `simulate`
# does so with `actuator={"levers": "uniform", "servo_gain": …}`.

# %%
jacobian = plant.rigid_jacobian(q=plant.rest(base=best.base, posture=best.posture, p=p)["q"], base=best.base, p=p)["Jv"]
rates = np.linalg.pinv(jacobian.full()) @ (2 * velocity)
for saturation in ("none", "uniform"):
    lever = hydraulics.lever_map(saturation)(posture=best.posture, rates=rates, p=p)["lever"]
    print(f"{saturation:>8}", lever.full().ravel().round(3))

# %% [markdown]
# ## C for its controller
#
# The bundle explains itself, and carries its own tests. How `verify_bundle` proves one, [from a posture to C](posture_to_c.ipynb)
# shows.

# %%
import tempfile

with tempfile.TemporaryDirectory() as folder:
    exported = flexopt.export_c(machine, f"{folder}/bundle", parts=["kinematics", "controller"])
print(exported.parts)
