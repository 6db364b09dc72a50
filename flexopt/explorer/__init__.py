"""The explorer: one page that computes with the machine's own graphs in the browser.

In: a machine or a problem. Out: an HTML page without network or server; in notebooks it shows itself.
"""

from flexopt.explorer.exploring import Explorer as Explorer
from flexopt.explorer.exploring import explore as explore
