"""Studies on top of everything else: the article's tables, and the examination of an installation.

In: machines. Out: result objects that carry printed and computed numbers side by side.
"""

from flexopt.study.article import ArticleTable as ArticleTable
from flexopt.study.article import reproduce_table2 as reproduce_table2
