"""What every room stands on and what knows no machine: plain values, quantities, checked calls, files, processes.

In: what callers pass, numbers, text, paths. Out: checked values or one error with every fault; files written whole.
"""
