"""Speed and accuracy beside peers, as ratios taken in one run; each module prints its own table."""
