"""What exists for the article alone: its Table 2, Figs. 5 to 12 and claims, computed again; their pictures and page.

In: nothing, or a machine in the article's place. Out: printed and computed numbers side by side. Nothing but the
command line imports it.
"""

from flexopt.article.curves import Curve as Curve
from flexopt.article.curves import curve as curve
from flexopt.article.findings import ArticleFinding as ArticleFinding
from flexopt.article.gaps import GapSweep as GapSweep
from flexopt.article.gaps import sweep_gaps as sweep_gaps
from flexopt.article.reproduction import Reproduction as Reproduction
from flexopt.article.reproduction import reproduce as reproduce
from flexopt.article.tables import ArticleTable as ArticleTable
from flexopt.article.tables import reproduce_table2 as reproduce_table2
from flexopt.foundation import matplotlib_apart as matplotlib_apart
