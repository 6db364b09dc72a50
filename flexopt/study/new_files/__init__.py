"""Machine files to begin with: a planar one, or one around a robot file.

In: answers, as plain data. Out: the text of a file and the machine that is read from it.
"""
