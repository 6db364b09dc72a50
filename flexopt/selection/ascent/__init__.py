"""The ascent of objectives that have kinks: its steps, what each configuration gives to them, their cone programs.

In: a program's configurations at a point. Out: a better point, or what stopped it.
"""
