"""Studies on top of everything else: maps, reports on problems, the article computed again, the installation examined.

In: machines and problems. Out: result objects that carry printed and computed numbers side by side.
"""

from flexopt.article.curves import Curve as Curve
from flexopt.article.curves import curve as curve
from flexopt.article.findings import Finding as Finding
from flexopt.article.gaps import GapSweep as GapSweep
from flexopt.article.gaps import sweep_gaps as sweep_gaps
from flexopt.article.reproduction import Reproduction as Reproduction
from flexopt.article.reproduction import reproduce as reproduce
from flexopt.article.tables import ArticleTable as ArticleTable
from flexopt.article.tables import reproduce_table2 as reproduce_table2
from flexopt.study.problem_report import Report as Report
from flexopt.study.problem_report import report as report
from flexopt.study.workspace import map_workspace as map_workspace
from flexopt.study.workspace_map import WorkspaceMap as WorkspaceMap
