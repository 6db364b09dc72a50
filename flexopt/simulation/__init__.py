"""The nonlinear closed loop: controllers, integrators, runs, ensembles, and what they show."""
