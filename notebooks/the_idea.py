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
# # The idea in ten minutes
#
# A controller holds the end-point of an excavator's arm. It measures the end-point and pushes it back where it should be, as if
# the undercarriage stood on rock. It does not: the ground gives. In some postures that is harmless, in others the same
# controller pumps the vibration up until the machine dances. Which posture is which can be told beforehand.
#
# Units are SI, angles in radians, points in the inertial frame.

# %%
# %matplotlib inline
import numpy as np
from matplotlib.figure import Figure

import flexopt

machine = flexopt.load("excavator")
posture_a, posture_b = [0.9929, -2.6306], [0.0448, -2.0499]  # boom and stick, from the article's Table 2

# %% [markdown]
# ## Same controller, two postures
#
# A spring and a damper in task space, turned into torques by the inverse of the arm's Jacobian, sampled at 200 Hz. The arm starts a
# little off its target.

# %%
gains = {"kp": 1e5, "kv": 2e3}  # N m, N m s
runs = {name: flexopt.simulate(machine, posture, **gains) for name, posture in (("A", posture_a), ("B", posture_b))}
for name, run in runs.items():
    print(f"posture {name}: the vibration {run.verdict}")

# %%
figure = Figure(figsize=(8.0, 2.8), layout="constrained")
for axes, (name, run) in zip(figure.subplots(1, 2), runs.items(), strict=True):
    axes.plot(run.time, 1e3 * run.deflection[:, machine.coordinates.index("base.rotation")], linewidth=0.7)
    axes.set_title(f"posture {name}")
    axes.set_xlabel("time, s")
    axes.set_ylabel("turn of the undercarriage, mrad")
figure

# %% [markdown]
# ## Why: a push and its answer
#
# Every mode of vibration $i$ has two arrows at the end-point. $b_i$ says how strongly, and by which push, feedback excites the mode;
# $a_i$ says how the end-point moves when the mode swings. The plant that the controller meets is
#
# $$P(s) = \frac{R_0}{s^2} + \sum_i \frac{a_i b_i^\mathsf{T}}{s^2 + 2\zeta_i\omega_i s + \omega_i^2} .$$
#
# Velocity feedback pushes against the motion that it sees. Where $a_i$ and $b_i$ point the same way, that push brakes the mode. Where
# they point in opposite ways, it drives it.

# %%
figure = Figure(figsize=(8.0, 3.4), layout="constrained")
for axes, (name, posture) in zip(figure.subplots(1, 2), (("A", posture_a), ("B", posture_b)), strict=True):
    found = flexopt.explain(machine, posture)
    for vector, color, label in (
        (found.a[:, 0], "#aa4164", "a: how it moves"),
        (found.b[:, 0], "#899d25", "b: what excites it"),
    ):
        x, y = vector / np.linalg.norm(vector)
        axes.annotate("", xy=(x, y), xytext=(0, 0), arrowprops={"color": color, "width": 2, "headwidth": 9})
        axes.plot([], [], color=color, linewidth=3, label=label)
    axes.set(
        xlim=(-1.2, 1.2),
        ylim=(-1.2, 1.2),
        aspect="equal",
        title=f"{name}, first mode: {np.degrees(found.angle[0]):.0f}° apart",
    )
    axes.set_xlabel("x")
    axes.set_ylabel("y")
    axes.legend(loc="lower right", fontsize=8)
figure

# %% [markdown]
# ## One number for it
#
# The measure $w_i = a_i \cdot b_i - |a_i||b_i|$ is the least eigenvalue of $R_i + R_i^\mathsf{T}$, $R_i = a_i b_i^\mathsf{T}$. It is 0 where the
# arrows point the same way and $-2|a_i||b_i|$ where they are opposite. It needs no gains, and a change of stiffness or mass moves it
# only a little. `explain` puts it in words, and says which way to move:

# %%
flexopt.explain(machine, posture_a)

# %% [markdown]
# ## Move it yourself
#
# Drag the end-point or the base. The map is coloured by $w_1$; the sliders change gains, dead time, load and ground. All of it is computed
# in this page.

# %%
flexopt.explore(machine, posture_a)

# %% [markdown]
# ## Let it be chosen
#
# The base may stand elsewhere while the end-point keeps its place. `select` finds the stands where $w_1$ is greatest, and checks each
# answer by functions that the solver did not use.

# %%
selection = flexopt.select(machine, (0.0, 1.6), base=0.0)
selection.plot()

# %%
best = selection.best.evaluation
print("base", best.base, "posture", best.posture.round(4), "w", best.w)
print("proven to be the best:", flexopt.certify(selection).verdict)
print("the same controller there:", flexopt.simulate(machine, best.posture, base=best.base, **gains).verdict)

# %% [markdown]
# ## And what is it worth?
#
# A measure compares places; it does not say how fast a vibration dies away. `outcome` does, for a given controller, its sampling and its
# dead time:

# %%
for name, posture, base in (("A", posture_a, 0.0), ("B", posture_b, 0.0), ("chosen", best.posture, best.base)):
    found = flexopt.outcome(machine, posture, base=base, loop={"kp": 1e4, "kv": 1e3})
    if found.decay > 0:
        print(f"{name:>6}: decays at {found.decay:.3f}/s; bears {1e3 * found.delay_margin:.1f} ms more dead time")
    else:
        print(f"{name:>6}: grows at {-found.decay:.3f}/s")

# %% [markdown]
# Which of these places to take on ground that nobody measured is the question of [the notebook on unknown ground](unknown_ground.ipynb); how to
# bring in another machine, that of [your own machine](your_own_machine.ipynb).
