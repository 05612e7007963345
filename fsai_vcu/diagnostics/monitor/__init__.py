"""The bus at this moment, for people who stand beside the car: a picture a few times a second.

    view = View()                       # view.py: frames in, with their times; knows no clock
    view.update(frames)                 # frames.Frames, as they come
    picture = view.picture(now_ns)      # snapshot.py: everything there is to show, as plain data
    view.signals(["*_TRQ*"], now_ns)    # state_history.py: values and when they changed; bytes and events likewise
    source = Live(chunks, view)         # sources.py: a bus as it is now, or PlayedLog: any moment of a log
    MonitorApp(source, 0.25).run()      # app.py, drawing.py: pages on a terminal

What stands between now and driving is said by the rules that explain a log (explain/starting.py).
"""
