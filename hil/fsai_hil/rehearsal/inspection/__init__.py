"""Any AI-side program on a bus with our VCU and car, put through what scrutineering and the interface ask of it.

items       what is asked, by whom, and in which scene it is looked at
judge       what the frames on the bus show of it; pure
scenes      what people and faults do at the car, scene by scene; pure
rehearsal   car, scenes and judge together in virtual time; pure
program     the program as a process, and the bus
report      the result for people: in a terminal and as a page to print
"""
