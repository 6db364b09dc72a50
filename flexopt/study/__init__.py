"""Studies on top of everything else: maps, reports on problems, the installation examined.

In: machines and problems. Out: result objects, and pages of them.
"""

from flexopt.study.explanation import Explanation as Explanation
from flexopt.study.explanation import explain as explain
from flexopt.study.maps.joint_atlas import atlas as atlas
from flexopt.study.maps.loop_map import map_loop as map_loop
from flexopt.study.maps.workspace import map_workspace as map_workspace
from flexopt.study.maps.workspace_map import WorkspaceMap as WorkspaceMap
from flexopt.study.reports.report import report as report
from flexopt.study.reports.result import Report as Report
from flexopt.study.verdicts.result import Verdict as Verdict
from flexopt.study.verdicts.verdict import verdict as verdict
