"""The preloaded `ptrace` sets registers from a buffer that is too short for this processor, and only changed ones.

A buffer that ends behind the first part is too short on every processor with AVX, as User-Mode Linux's is with AMX.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from fsai_hil.vcan.preload import COMPILER, built
from fsai_hil.vcan.uml import _why

SET_AND_READ = """
import ctypes, math, os, signal
libc = ctypes.CDLL(None, use_errno=True)
libc.ptrace.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p]
TRACE_ME, CONTINUE, KILL, GET, SET, XSTATE = 0, 7, 8, 0x4204, 0x4205, 0x202
XMM0, FIRST_PART = 160, 576
class Buffer(ctypes.Structure):
    _fields_ = [("base", ctypes.c_void_p), ("len", ctypes.c_size_t)]
def trace(request, registers, size):
    buffer = Buffer(ctypes.addressof(registers), size)
    done = libc.ptrace(request, child, XSTATE, ctypes.addressof(buffer))
    return (os.strerror(ctypes.get_errno()) if done else "done"), buffer.len
child = os.fork()
if child == 0:
    libc.ptrace(TRACE_ME, 0, None, None)
    while True:
        os.kill(os.getpid(), signal.SIGSTOP)
        math.sqrt(os.getpid() * 1.5)  # in the SSE registers
os.waitpid(child, 0)
registers, after = ctypes.create_string_buffer(1 << 16), ctypes.create_string_buffer(1 << 16)
size = trace(GET, registers, len(registers))[1]
if size <= FIRST_PART:
    print("this processor has no registers behind the first part")
else:
    for number in range(2):  # the second time it is known that the whole is wanted
        registers[XMM0 : XMM0 + 16] = bytes([number + 1]) * 16
        registers[512] = registers.raw[512] | 2  # the SSE registers are in the buffer
        print(trace(SET, registers, FIRST_PART)[0], end=" ")
    trace(GET, after, len(after))
    print(after.raw[XMM0 : XMM0 + 16] == registers.raw[XMM0 : XMM0 + 16], end=" ")
    read_bytes = trace(GET, registers, FIRST_PART)[1]
    libc.ptrace(CONTINUE, child, None, None)
    os.waitpid(child, 0)  # meanwhile it has changed them
    trace(SET, registers, read_bytes)
    trace(GET, after, len(after))
    print(after.raw[XMM0 : XMM0 + 16] == registers.raw[XMM0 : XMM0 + 16])
libc.ptrace(KILL, child, None, None)
"""


def test_registers_are_set_from_a_short_buffer_where_changed(tmp_path: Path) -> None:
    library = built("registers", tmp_path)
    if library is None:
        pytest.skip("there is no C compiler, or this is no x86-64")

    def said(preloaded: str) -> str:
        command = [sys.executable, "-c", SET_AND_READ]
        done = subprocess.run(command, env={"LD_PRELOAD": preloaded}, capture_output=True, text=True, check=False)
        assert done.returncode == 0 and not done.stderr, done.stderr
        return done.stdout.strip()

    if said("").startswith("this processor"):
        pytest.skip(said(""))
    assert said("").startswith("Bad address Bad address False"), "the machine's own ptrace refuses it"
    assert said(str(library)) == "done done True True"


def test_registers_that_cannot_be_set_say_what_to_install() -> None:
    log = "Linux version 6.1.176\nuserspace - ptrace set fp regs failed, errno = 14\nKernel panic\n [<6002c0dd>]"
    assert _why(log).startswith("userspace - ptrace set fp regs failed") and _why(log).endswith(COMPILER)
    assert _why("Linux version 6.1.176\n") == "Linux version 6.1.176" and _why("") == "no message"
