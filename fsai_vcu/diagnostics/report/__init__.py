"""A run as one page: plots, story and figures in a single HTML file that needs nothing else.

html = page(frames, "run.log")            # page.py puts it together
curves.py                                 # signals thinned out to what a screen can show
page.css, page.js                         # how it looks and moves; both go into the file, named by their hashes
"""

from fsai_vcu.diagnostics.report.page import page

__all__ = ["page"]
