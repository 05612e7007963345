"""A run as one page: plots, explanation and figures in a single HTML file that needs nothing else.

html = page_of(record, buses, verdict, "run.log")       # page.py puts it together
curves.py                                               # signals thinned out to what a screen can show
page.css, page.js                                       # both go into the file, named by their hashes
"""
