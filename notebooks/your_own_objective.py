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
# # Your own objective
#
# What is chosen may be yours. Either a `casadi.Function` goes into flexopt's selection, with its proof and its ranking; or flexopt's graphs go into
# your own program, here `casadi.Opti`. Both are exact: every graph has derivatives of first and second order.

# %%
# %matplotlib inline
import casadi as ca
import numpy as np

import flexopt

machine = flexopt.load("excavator")
target = (0.0, 1.6)

# %% [markdown]
# ## A function of your own in flexopt's selection
#
# Inputs are named by quantities that flexopt knows. Of all places that keep the best $w_1$ to a thousandth, the one that is held with the least torque,
# where the end-point sags by 5 mm at most:

# %%
torques, sag = ca.MX.sym("torques", 2), ca.MX.sym("sag", 2)  # N m; m
least_torque = ca.Function("least_torque", [torques], [-ca.norm_2(torques)], ["torques"], ["value"])
sag_length = ca.Function("sag_length", [sag], [ca.norm_2(sag)], ["sag"], ["length"])
choice = flexopt.select(
    machine,
    target,
    base=0.0,
    objective=["w1", least_torque],
    slack=1e-3,
    constraints=[flexopt.Constraint(sag_length, upper=0.005, unit="m")],
)
choice

# %%
choice.plot()

# %% [markdown]
# A name that is not known is answered with those that are:

# %%
w9 = ca.MX.sym("w9")
try:
    flexopt.select(machine, target, objective=ca.Function("f", [w9], [w9], ["w9"], ["value"]))
except flexopt.InputError as error:
    print(error)

# %% [markdown]
# ## flexopt's graphs in your own program
#
# `build_plant` and `build_measures` give CasADi Functions of placement, posture and *all parameters of the machine*. So a question that flexopt
# does not ask can be asked in a few lines: how long should the stick be, and where should the machine stand, so that all modes together are excited
# least at this target? The length is a variable like any other.

# %%
plant, measures = flexopt.build_plant(machine), flexopt.build_measures(machine, "inverse")
names = [parameter.name for parameter in machine.parameters]
k = names.index("stick.length")
print(measures.w)

opti = ca.Opti()
base, posture, length = opti.variable(), opti.variable(2), opti.variable()
p = ca.vertcat(*[length if i == k else plant.parameter_values[i] for i in range(len(names))])
w, scale, end_point = measures.w(base, posture, p)
opti.minimize(-1e5 * ca.sum1(w))  # of order one
opti.subject_to(end_point == ca.DM(target))
opti.subject_to(opti.bounded(0.8, length, 1.4))  # m
opti.subject_to(opti.bounded(-3, base, 3))  # m
opti.subject_to(plant.singularity_sine_squared(base, posture, p) >= np.sin(np.deg2rad(10)) ** 2)
opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-9})

# %% [markdown]
# IPOPT finds one local optimum from one start, so several starts are tried: places of the base in which the present stick reaches the target. What
# it returns is believed only after another look: here `evaluate` of the machine with that stick.

# %%
own = machine.parameters[k].value
found = []
for x in np.linspace(-2.5, 2.5, 11):
    for start in flexopt.inverse_kinematics(machine, target, base=x):
        opti.set_initial(base, x)
        opti.set_initial(posture, start)
        opti.set_initial(length, own)
        try:
            solution = opti.solve()
        except RuntimeError:  # this start leads nowhere
            continue
        found.append(
            [solution.value(base), *solution.value(posture), solution.value(length), solution.value(ca.sum1(w))]
        )
found = np.array(found)
best = found[found[:, -1].argmax()]
print(
    f"{len(found)} solves; base {best[0]:.4f} m, posture {best[1:3].round(4)} rad, stick {best[3]:.4f} m instead of {own} m"
)

# %%
data = machine.to_dict()
links = [link | {"length": best[3]} if link["name"] == "stick" else link for link in data["links"]]
longer = flexopt.machine_from_dict(data | {"links": links})
at = flexopt.evaluate(longer, best[1:3], base=best[0])
as_it_is = flexopt.select(machine, target, base=0.0, objective="V", weights=[1, 1, 1])
print("end-point", at.end_point.round(9), " V by evaluate", at.w.sum(), " by the program", best[-1])
print("with the stick as it is, chosen by flexopt:", as_it_is.best.evaluation.w.sum())

# %% [markdown]
# Gradients of your program are exact, too; at a point that is no optimum, beside a central difference:

# %%
z = ca.vertcat(base, posture, length)
slope = ca.Function("slope", [z], [ca.sum1(w), ca.gradient(ca.sum1(w), z)])
here, h = np.array([0.2, 0.9, -2.3, 1.0]), 1e-6
exact = slope(here)[1].full().ravel()
central = [(float(slope(here + h * e)[0]) - float(slope(here - h * e)[0])) / (2 * h) for e in np.eye(4)]
print(exact, np.array(central), sep="\n")
