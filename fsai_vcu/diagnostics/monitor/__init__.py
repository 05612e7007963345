"""The bus at this moment, for people who stand beside the car: a picture a few times a second.

    view = View()                       # view.py: frames in, with their times; knows no clock
    view.update(frames)                 # frames.Frames, as they come
    picture = view.picture(now_ns)      # snapshot.py: everything there is to show, as plain data
    screen_lines(picture, 80, 24, …)    # drawing.py: as lines of a terminal; plain_line: as one line
    Screen().draw(lines)                # screen.py: the terminal itself

`why_not_driving.py` says what stands between now and driving, by the rules of the story of a log.
"""
