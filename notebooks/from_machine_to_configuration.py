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
# # From a machine file to a configuration
#
# An excavator works at a point with end-point feedback. Its undercarriage gives, nobody measures that, and the controller treats
# the ground as rigid. In some postures the feedback pumps the undercarriage's oscillation up; in others it cannot. This
# notebook walks from the machine's numbers to a base position and an arm posture of the second kind.
#
# Units are SI, angles in radians, points in the inertial frame.

# %%
# %matplotlib inline
import numpy as np
from matplotlib.figure import Figure

import flexopt

machine = flexopt.load("excavator")
machine

# %% [markdown]
# ## The plant
#
# The machine becomes CasADi graphs once. Passive coordinates come first (the undercarriage's displacement and rotation), then the
# actuated joints. Every function takes named inputs; `p` is the vector of the machine's parameters, so masses and
# stiffnesses stay symbols.

# %%
plant = flexopt.build_plant(machine)
p = plant.parameter_values
print(plant)
print(plant.coordinates)
posture_a = flexopt.inverse_kinematics(machine, (0.0, 1.6), base=0.0)[0]
q = plant.rest(base=0, posture=posture_a, p=p)["q"]
print("posture A:", posture_a)
print("M =", plant.mass(q=q, p=p)["M"].full().round(1), sep="\n")

# %% [markdown]
# ## The plant that the controller meets
#
# With `f` the task-space feedback and the arm's own Jacobian inverted, the linear plant is
# $P(s) = C(sI - A)^{-1}B = R_0/s^2 + \sum_i R_i/(s^2 + 2\zeta_i\omega_i s + \omega_i^2)$, and each $R_i = a b^\mathsf{T}$ has rank
# one. A check that needs no eigenvalue: $R_0 + \sum_i R_i = CAB$.

# %%
A, B, C = (x.full() for x in plant.linearisation("inverse").call([0, posture_a, p]))
evaluation = flexopt.evaluate(machine, posture_a, control="inverse")
total = evaluation.rigid_residue + evaluation.residues.sum(axis=0)
print("largest difference:", np.abs(total - C @ A @ B).max())
evaluation

# %% [markdown]
# The measure $w_i = \lambda_{\min}(R_i + R_i^\mathsf{T}) = a\cdot b - |a||b|$ is at most zero. Posture A is poor: in its first mode, at 3 Hz,
# $w_1$ is nearly $-2|a||b|$, the worst there is. The end-point moves against the push of the feedback.
#
# What that does to the nonlinear closed loop is a matter of its gains; what it says without any gain is that the flexible part
# of the plant is not positive real.

# %% [markdown]
# ## Which way is up
#
# Gradients are exact, by base, posture and every parameter. Here is the one by posture, beside a central difference, and
# the three parameters that $w_1$ reacts to most (for one percent of each).

# %%
h = 1e-6
difference = [
    (flexopt.evaluate(machine, posture_a + h * d).w - flexopt.evaluate(machine, posture_a - h * d).w) / (2 * h)
    for d in np.eye(2)
]
print("exact:   ", evaluation.gradient.w[0, 1:])
print("central: ", np.array(difference)[:, 0])
percent = 0.01 * evaluation.gradient.w_parameters[0] * p.full().ravel()
for k in np.argsort(-np.abs(percent))[:3]:
    print(f"{evaluation.gradient.parameters[k]:>16}: one percent more changes w1 by {percent[k]:+.2e}")

# %% [markdown]
# ## The redundancy
#
# The base may stand anywhere along x as long as the arm still reaches the target. `build_selection` sets up the nonlinear
# program and scans that redundancy; `solve_selection` lets IPOPT polish every peak and then checks each answer with
# functions that IPOPT did not use.

# %%
problem = flexopt.build_selection(machine, (0.0, 1.6), objective="w1", control="inverse", base=0.0)
for variable in problem.variables:
    print(variable)
for constraint in problem.constraints:
    print(constraint)
print(problem.scan.size, "scanned configurations")

# %%
selection = flexopt.solve_selection(problem)
selection

# %% [markdown]
# Several postures reach $w_1 = 0$; ties are broken by the worst of the other measures. Where a posture rests on a bound or on
# the distance from singular postures, that is said.

# %%
selection.plot()

# %% [markdown]
# ## The structure behind it
#
# $w_i = 0$ means $a \times b = 0$ with $a\cdot b > 0$: a curve in the plane of the two joint angles. The base does not enter, only
# through which angles reach the target. The map below is computed by the same CasADi function as everything above, called
# with all postures at once; the target's redundancy is drawn over it.

# %%
n = 180
angles = -np.pi + 2 * np.pi * (np.arange(n) + 0.5) / n  # centres of cells: a stick at 0 or π is singular
boom, stick = np.meshgrid(angles, angles)
measures = flexopt.build_measures(machine, "inverse")
postures = np.vstack([boom.ravel(), stick.ravel()])
w, scale, _ = measures.w.call([np.zeros((1, n * n)), postures, p])
ratio = (w.full()[0] / scale.full()[0]).reshape(n, n)

figure = Figure(figsize=(6.4, 5.2), layout="constrained")
axes = figure.add_subplot()
image = axes.pcolormesh(boom, stick, ratio, cmap="viridis", vmin=-2, vmax=0, shading="nearest", rasterized=True)
figure.colorbar(image, label="$w_1 / |a||b|$: 0 robust, −2 worst")
axes.plot(problem.scan.posture[0], problem.scan.posture[1], ".", color="white", markersize=1.5)
for rank, candidate in enumerate(selection.candidates):
    marker, size = ("*", 15) if rank == 0 else ("o", 5)
    axes.plot(*candidate.evaluation.posture, marker, color="#d95f02", markeredgecolor="black", markersize=size)
axes.plot(*posture_a, "s", color="#3b6ea5", markeredgecolor="white")
axes.set_xlabel("boom θ2, rad")
axes.set_ylabel("stick θ3, rad")
axes.set_title(
    "mode 1, inverse control: postures that reach the target (white),\npresent (square), chosen (star)", fontsize=10
)
figure

# %% [markdown]
# ## With gravity, and with damping
#
# Under gravity the machine settles; the target is then met by the settled end-point, and gravity's stiffness enters the
# passive block. With the little damping of the article's table the damped measures differ from the undamped ones in the
# eighth digit.

# %%
settled = flexopt.select(machine, (0.0, 1.6), base=0.0, gravity=True)
print("chosen base and posture, at rest:       ", selection.best.evaluation.base, selection.best.evaluation.posture)
print("chosen base and posture, under gravity: ", settled.best.evaluation.base, settled.best.evaluation.posture)
print("static deflection, m and rad:           ", settled.best.evaluation.static_deflection)
damped = flexopt.evaluate(machine, posture_a, damped=True)
print("largest change by damping, of |a||b|:   ", damped.damped_difference)
