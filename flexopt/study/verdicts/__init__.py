"""Does it pay to move? The present place beside those chosen, over what is uncertain, by a stated rule.

In: a configuration problem or its answer, a loop. Out: a `Verdict`, its page and picture.
"""
