"""FMUs of the closed loop for FMI 2.0 and 3.0, from the graphs that `flexopt.simulate` runs.

In: a machine and the options of a simulation. Out: an FMU (`export_fmu`) with its reference trajectory.
"""

from flexopt.export.fmu.interface import KINDS as KINDS
from flexopt.export.fmu.package import FmuReport as FmuReport
from flexopt.export.fmu.package import export_fmu as export_fmu
from flexopt.export.fmu.source import VERSIONS as VERSIONS
