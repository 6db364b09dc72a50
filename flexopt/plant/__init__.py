"""From a machine to CasADi graphs: kinematics and its inverse, dynamics, rest and static deflection, linearisation.

In: a validated machine. Out: a `Plant` of SX graphs and named Functions; everything downstream reads
only that.
"""

from flexopt.plant.hydraulics import Hydraulics as Hydraulics
from flexopt.plant.hydraulics import build_hydraulics as build_hydraulics
from flexopt.plant.inverse_kinematics import inverse_kinematics as inverse_kinematics
from flexopt.plant.plant import Plant as Plant
from flexopt.plant.plant import build_plant as build_plant
from flexopt.plant.plant import moving_end_point as moving_end_point
