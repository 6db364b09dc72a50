"""The nonlinear program of one or many configurations that belong together: graphs, assembly, numbers, solvers.

In: `SelectionProblem`s of one machine. Out: a `Program`: points, values and slopes there, and solves from them.
"""
