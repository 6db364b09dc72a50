"""What is proven of the sampled loop over a box of uncertain numbers, and the largest box that is stable.

In: a loop with its box. Out: where it decays, where it grows, where neither is proven; `region`.
"""
