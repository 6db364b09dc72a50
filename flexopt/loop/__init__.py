"""The closed loop as graphs: controllers, sampling, actuators, integrators, the exact tangent, and what the loop does.

In: a plant and a loop's structure. Out: CasADi graphs of one step of the machine under its controller; measures of the
sampled linear loop with exact derivatives. Below the choice of a posture, so that a posture can be chosen by them.
"""
