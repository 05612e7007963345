"""The page for everybody around the car: a bus as it is now, or a log at any of its moments. It never sends.

html = of_log(judged, "run.log")      # document.py: a single HTML file that needs nothing else
state = state_of(picture)             # board.py: a monitor's picture as what the tiles show; states_of: of a whole log
curves.py                             # signals thinned out to what a screen can show, lanes of states, the driven path
trace = Trace()                       # trace.py: the driven path of a bus, as the frames come
server = Server(host, port, page)     # server.py: over HTTP; publish() reaches every viewer
page.html, page.css, page.js          # one page and its drawing, for both
"""
