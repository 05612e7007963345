"""The bus on one web page, for everybody around the car: reads, and never sends.

state_of(moment)                # board.py: a monitor's picture as what the page shows, JSON types
trace = Trace()                 # trace.py: the way driven in this run
server = Server(host, port)     # server.py: page and events over HTTP; publish() reaches every viewer
"""
