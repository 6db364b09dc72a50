"""The closed loop as graphs: controllers, sampling, actuators, integrators, and the exact tangent of a sampled step.

In: a plant and a loop's structure. Out: CasADi graphs of one step of the machine under its controller. Below the
choice of a posture, so that a posture can be chosen by what its loop does.
"""
