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
# # The closed loop
#
# The measures $w_i$ and $\varepsilon_{max}$ are promises about small motions. Here the nonlinear closed loop is run: the machine on its
# springs, a sampled controller that sees the end-point and the joints and nothing of the base, ten seconds at 200 Hz.

# %%
# %matplotlib inline
import numpy as np

import flexopt

machine = flexopt.load("excavator")
posture_a = [0.9929, -2.6306]  # the article's Table 2
posture_b = [0.0448, -2.0499]
gains = {"kp": 1e5, "kv": 2e3}  # the article prints none; these show its figures

# %% [markdown]
# ## The same controller in two postures
#
# In posture A the feedback pumps energy into the base's first mode; in posture B it takes energy out of it. The measure says
# so beforehand, the sampled linear loop says how fast, and the nonlinear run shows it.

# %%
for name, posture in (("A", posture_a), ("B", posture_b)):
    w1 = flexopt.evaluate(machine, posture).w[0]
    loop = flexopt.sampled_loop(machine, posture, **gains)
    run = flexopt.simulate(machine, posture, **gains)
    print(f"{name}: w1 = {w1:.2e}, linear growth {loop.growth_rate:+.3f}/s")
    print(run)

# %%
flexopt.simulate(machine, posture_a, **gains).plot()

# %% [markdown]
# `growth_rate` is that of the largest mode that grows, or else of the one that decays slowest: half the slope of the logarithm of
# its energy. The verdict is made from it and from the eigenvalues of the linear loop, not from how the picture looks; where the two differ, because the run
# is too short or its integrator damps a mode by itself, it is "undecided", and `verdict_reason` says why.
#
# ## How much gain a posture allows
#
# `stability_border` searches Kp for the edges of stability of the sampled linear loop, from 10⁻⁴ to 10⁴ times one that suits
# the machine's masses. At Kv = 2000 N m s posture A has
# no stable gain at all: the damping gain alone drives the base. The optimised posture allows a wide range.

# %%
best = flexopt.select(machine, (0.0, 1.6), base=0.0).best.evaluation
for name, posture, base in (("A", posture_a, 0.0), ("B", posture_b, 0.0), ("optimised", best.posture, best.base[0])):
    border = flexopt.stability_border(machine, posture, base=float(base), kv=2e3)
    intervals = [f"{low:.3g} … {high:.3g} N m" for low, high in border.intervals]
    print(f"{name:10s}", intervals or "none from {:.3g} to {:.3g} N m".format(*border.searched))

# %% [markdown]
# ## Moving the base while the end-point is held
#
# The article's nullspace law drives the base uphill on $w_1$; the end-point's target stays where it is. The run starts in
# posture A, where it would diverge, and reaches posture B in time.

# %%
climb = flexopt.nullspace_trajectory(machine, posture_a, base_range=(-1.50017, 0.0), max_base_acceleration=0.1)
print(climb.stop.value)
moved = flexopt.simulate(machine, posture_a, base_path=climb.path, duration=20.0, **gains)
stayed = flexopt.simulate(machine, posture_a, duration=20.0, **gains)
print(moved, stayed, sep="\n")

# %%
from flexopt.plotting import plot_trajectories

plot_trajectories({"base moved": moved, "base left where it was": stayed})

# %% [markdown]
# ## What nobody measures
#
# Stiffness of the ground, load in the bucket, where the motion starts: five hundred machines that the controller does not
# know, run side by side. The controller keeps the numbers of the machine in the file.

# %%
rng = np.random.default_rng(1)
members = 500
vary = {
    "base.stiffness.rotation": 1.112e6 * rng.uniform(0.5, 1.5, members),
    "payload.mass": rng.uniform(0.0, 600.0, members),
    "offset": rng.normal(0.0, 0.03, (members, 2)),
}
for name, posture, base in (("A", posture_a, 0.0), ("optimised", best.posture, best.base[0])):
    print(name, flexopt.simulate_ensemble(machine, posture, base=float(base), vary=vary, duration=30.0, **gains))

# %% [markdown]
# ## A controller that knows the base
#
# Where a model of the base is at hand after all, the controller that attains $\varepsilon_{max}$ stabilises posture A, too. It is designed
# for the plant as the hold makes it, so a run of it wants an integrator that does not damp the fast modes: explicit RK4 at
# 5 ms does, and makes another loop of it.

# %%
for integrator in ("rk4", "exact"):
    loop = flexopt.sampled_loop(machine, posture_a, feedback="robust", integrator=integrator)
    print(integrator, loop)
print(flexopt.simulate(machine, posture_a, feedback="robust", integrator="dop853", duration=30.0))
