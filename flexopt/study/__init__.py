"""Studies on top of everything else: maps, reports on problems, the installation examined.

In: machines and problems. Out: result objects, and pages of them.
"""

from flexopt.study.explanation import Explanation as Explanation
from flexopt.study.explanation import explain as explain
from flexopt.study.joint_atlas import atlas as atlas
from flexopt.study.loop_map import map_loop as map_loop
from flexopt.study.move_verdict import verdict as verdict
from flexopt.study.problem_report import report as report
from flexopt.study.report_result import Report as Report
from flexopt.study.verdict_result import Verdict as Verdict
from flexopt.study.workspace import map_workspace as map_workspace
from flexopt.study.workspace_map import WorkspaceMap as WorkspaceMap
