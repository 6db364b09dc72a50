"""Everything about one configuration problem on one page: what is computed, its tables, what is around the choice.

In: a problem. Out: a `Report`.
"""
