"""Diagnostics of what was, or is, on the bus: logs, decoding, statistics. It knows no ROS and takes no decisions.

Frames
    `log.frames.Frames` is a run of frames as columns (numpy), `LogFrame` is one of them. Times are integer
    nanoseconds of the log's own clock (for a live bus: of the wall clock).

Reading
    with open_log(path) as log:                # log/reader.py; '-' is standard input; the content tells the format
        for frames in log.chunks(): ...           # columns, a few ten thousand frames at a time: any length of log
        for frame in log.frames(): ...            # or one by one
        log.problems                              # what could not be read, with its place; never an exception
    read_log(path) -> (Frames, Problems)          # all of it at once
    guess_revision(frames)                        # decode/revision.py: the interface revision they are of, and why
    LiveSource(interfaces)                        # log/live.py: the same chunks(), from buses; Listener(bus): one

    log/formats.py is the table of formats: how each is told by its content, and its reader. A text has a reader of its
    rows (log/rows.py), candump's lines are read many at once (log/candump.py). log/stream.py unpacks and decodes.

Choosing
    FrameFilter.parse("520:7FF,#FFFFFFFF")        # log/filters.py: candump's filters, on columns

Decoding
    databases = load_databases(["team.dbc"])      # decode/databases.py; without files the car's own: revision="2026"
    decoder = Decoder(databases)                  # decode/decoder.py
    decoder.tables(frames)                        # {message name: MessageTable}; a table has times, rows and series
    decoder.tables(frames)["VCU2AI_Steer"].series["ANGLE"].values

    Values are those of cantools, to the last bit: messages that numpy can take apart are taken apart there, all others
    go through cantools itself. layouts.py is what is known of a message, as plain data.

Printing
    LineWriter(decoder, as_json=False).block(frames)      # decode/lines.py: lines of bytes; tails(): the signals only
    error_words(can_id, data)                             # decode/error_frames.py: an error frame of SocketCAN in words

Measuring
    measure(frames, decoder, revision=…)       # statistics/measure.py: a BusStatistics for each channel: periods,
                                                  # gaps, load, handshake
    judge(bus)                                 # verdict/of_bus.py: what is not as it should be (all: judging.py)
    wire_bits(frames)                           # statistics/wire_bits.py: exact length on the wire, stuff bits included
    quantile(ordered, share)                 # statistics/quantiles.py: one meaning of p50 and p99 everywhere

Watching, sending
    view = View(); view.update(frames); view.picture(now_ns)      # monitor/: one moment of a bus, and its drawing
    outgoing(databases, "BenchLamp", ["COLOUR=RED"])         # transmit/sending.py: a frame by its signals, or a refusal

On the command line the verbs share `Sources` (cli/sources.py: logs or interfaces as one stream of columns, with
filters, problems and an exit status) and `Decoding` (cli/decoding.py: databases as the arguments ask for, or as the
frames tell).
"""
