"""The nonlinear closed loop: controllers, integrators, runs, ensembles, and what they show.

In: a machine, a posture, a controller. Out: trajectories with their measures and a verdict. The loop is one set of
CasADi graphs; runs of it are compiled where that can be.
"""

from flexopt.model.simulation import Actuator as Actuator
from flexopt.model.simulation import Path as Path
from flexopt.model.simulation import Sensor as Sensor
from flexopt.simulation.ensemble import Ensemble as Ensemble
from flexopt.simulation.ensemble import simulate_ensemble as simulate_ensemble
from flexopt.simulation.experiment import run_experiment as run_experiment
from flexopt.simulation.linear import SampledLoop as SampledLoop
from flexopt.simulation.linear import StabilityBorder as StabilityBorder
from flexopt.simulation.linear import sampled_loop as sampled_loop
from flexopt.simulation.linear import stability_border as stability_border
from flexopt.simulation.run import simulate as simulate
from flexopt.simulation.trajectory import Trajectory as Trajectory
