"""Pictures of results.

In: result objects, which already hold every number that is drawn. Out: matplotlib figures, written where asked.
"""

from flexopt.foundation import matplotlib_apart as matplotlib_apart
from flexopt.plotting.animation import animate_trajectory as animate_trajectory
from flexopt.plotting.atlas import plot_atlas as plot_atlas
from flexopt.plotting.bands import plot_verdict as plot_verdict
from flexopt.plotting.base_trajectory import plot_base_trajectory as plot_base_trajectory
from flexopt.plotting.ensemble import plot_ensemble as plot_ensemble
from flexopt.plotting.explanation import plot_explanation as plot_explanation
from flexopt.plotting.identification import plot_identification as plot_identification
from flexopt.plotting.selection import plot_selection as plot_selection
from flexopt.plotting.sensitivity import plot_sensitivity as plot_sensitivity
from flexopt.plotting.several import plot_plan as plot_plan
from flexopt.plotting.several import plot_stand as plot_stand
from flexopt.plotting.trajectory import plot_trajectories as plot_trajectories
from flexopt.plotting.trajectory import plot_trajectory as plot_trajectory
from flexopt.plotting.workspace import plot_workspace as plot_workspace
