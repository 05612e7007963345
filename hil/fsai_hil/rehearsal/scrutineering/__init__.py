"""The response time of the AI computer, as scrutineering measures it: rehearsed on a real vcan0, in a report.

conditions  what is measured: how the car stands, and what else the machine and the bus have to do
load        that something else: busy processors, a busy disk, a full bus
machine     on what it was measured
measurement the measurement itself, with the real processes, where there is a vcan0
report      the figures for people, and the verdict
"""
