"""Pictures of results.

In: result objects, which already hold every number that is drawn. Out: matplotlib figures, written where asked.
"""

from flexopt.plotting.selection import plot_selection as plot_selection
from flexopt.plotting.workspace import plot_workspace as plot_workspace
