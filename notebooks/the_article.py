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
# # The article, and where it contradicts itself
#
# flexopt began with an article: *Configuration Optimization for End-Point Stabilization of Redundant Manipulators With Base
# Flexibility* (ASME Letters in Dynamic Systems and Control 1(2), 021001). Everything in it is computed again here. Most of it holds, to the
# printed digits. Some of it does not, and this notebook shows how that is known.
#
# `flexopt reproduce` writes all of it as a report; here are the steps that matter.

# %%
# %matplotlib inline
import numpy as np
from matplotlib.figure import Figure

import flexopt
from flexopt.article import curve, reproduce_table2

machine = flexopt.load("excavator")

# %% [markdown]
# ## Table 2
#
# Two postures, A and B, their measures and their robust margins. The article does not print the servo gain that belongs to
# $\varepsilon_{max}$; it is inferred from posture A, so that posture B is the check.

# %%
table = reproduce_table2()
table

# %% [markdown]
# Posture A is met to a quarter of a percent. Posture B is not: its three measures are those of another end-point, 23 cm further out. Two of
# the printed numbers cannot both be right, whatever the conventions; the row with workspace x = 1.5575 m is the one that agrees.
#
# ## Is posture B a maximum?
#
# The article moves the base uphill on $w_1$ and arrives at B. On the height of the target, all places of the base:

# %%
heights = {elbow: curve(machine, 1.087, control="inverse", elbow=elbow) for elbow in ("up", "down")}
figure = Figure(figsize=(8.0, 3.2), layout="constrained")
axes = figure.add_subplot()
for elbow, line in heights.items():
    axes.plot(line.x, line.w[0], ".", markersize=2, label=f"elbow {elbow}")
for name, x in (("A", -0.1733), ("B", 1.3269)):
    axes.axvline(x, color="black", linewidth=0.6)
    axes.annotate(name, (x, -1e-3), xytext=(4, 0), textcoords="offset points")
axes.set_xlabel("x of the end-point, workspace frame, m")
axes.set_ylabel("$w_1$, 1/(kg m²)")
axes.set_yscale("symlog", linthresh=1e-7)  # w_1 at B is a hundredth of that at A
axes.set_ylim(-5e-3, 1e-6)
axes.legend(loc="upper left", ncols=2)
figure

# %% [markdown]
# B lies on a slope: a little further along the same branch is better, and elsewhere $w_1$ reaches 0, which is the most there is. `select`
# finds those places, `certify` proves that none is better:

# %%
selection = flexopt.select(machine, (0.0, 1.6), base=0.0)
gradient = flexopt.evaluate(machine, [0.0448, -2.0499]).gradient.w[0]
print("slope of w1 at B, by base, boom and stick:", gradient)
selection

# %%
print(flexopt.certify(selection))

# %% [markdown]
# ## Positive real, and therefore passive?
#
# With $w_i = 0$ for all $i$ the flexible part of the plant is positive real. The article concludes that the whole plant is passive. That
# asks for more, $\lambda_{min}(R_0 + R_0^\mathsf{T}) \ge 0$ of the rigid part, which inverse control does not give in general:

# %%
rng = np.random.default_rng(0)
postures = rng.uniform([-3.1, -3.1], [3.1, -0.2], (400, 2)).T
rigid = [flexopt.evaluate(machine, posture).rigid for posture in postures.T[:60]]
print(f"negative at {np.mean(np.array(rigid) < 0):.0%} of 60 random postures")

# %% [markdown]
# ## What the measure does not see
#
# $w_1$ orders places by what *any* velocity feedback may do at worst. It does not say how fast the vibration dies away with a given one. Along the
# target's redundancy, with the exact sampled loop:

# %%
from scipy.stats import spearmanr

problem = flexopt.build_selection(machine, (0.0, 1.6), objective="w1", base=0.0)
scan = problem.scan
places = np.linspace(0, scan.size - 1, 120).astype(int)
columns = ({"kp": 1e4, "kv": 1e3}, {"kp": 1e5, "kv": 2e3}, {"kp": 1e4, "kv": 1e3, "dead_time": 0.02})
base, posture = scan.base[:, places], scan.posture[:, places]
w1 = flexopt.evaluate_w(flexopt.build_measures(machine), base, posture).w[0]
for loop in columns:
    decay = np.array(
        [flexopt.outcome(machine, q, base=b, loop=loop).decay for b, q in zip(base.T, posture.T, strict=True)]
    )
    print(loop, f"rank correlation of w1 and decay {spearmanr(w1, decay)[0]:.2f}, stable at {np.mean(decay > 0):.0%}")

# %% [markdown]
# Good places by $w_1$ are good places by and large. With dead time another choice, or other gains, may be the answer: `objective="decay"` and
# `verdict` ask for the outcome itself.
