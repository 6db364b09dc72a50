"""Studies on top of everything else: maps, reports on problems, the article computed again, the installation examined.

In: machines and problems. Out: result objects that carry printed and computed numbers side by side.
"""

from flexopt.study.article import ArticleTable as ArticleTable
from flexopt.study.article import reproduce_table2 as reproduce_table2
from flexopt.study.curves import Curve as Curve
from flexopt.study.curves import curve as curve
from flexopt.study.findings import Finding as Finding
from flexopt.study.gaps import GapSweep as GapSweep
from flexopt.study.gaps import sweep_gaps as sweep_gaps
from flexopt.study.problem_report import Report as Report
from flexopt.study.problem_report import report as report
from flexopt.study.reproduction import Reproduction as Reproduction
from flexopt.study.reproduction import reproduce as reproduce
from flexopt.study.workspace import map_workspace as map_workspace
from flexopt.study.workspace_map import WorkspaceMap as WorkspaceMap
