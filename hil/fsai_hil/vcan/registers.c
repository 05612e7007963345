/* Sets the vector registers of processes in User-Mode Linux: all of them, and only where they have changed.
 *
 * The kernel inside keeps each process's floating-point and vector registers in a buffer of fixed size (Linux 6.1: as far
 * as AVX-512 reaches), reads them by ptrace each time the process stops and sets them before it goes on. This machine's
 * kernel sets all registers of its processor or none (EFAULT): with AMX's tiles they are 11,008 bytes. Preloaded
 * (LD_PRELOAD), this library adds zeros to a buffer that is refused. The registers behind it stay as a new process has
 * them: no process inside can ask for permission to use them.
 *
 * Mostly the registers that are set are those that were read a moment ago: then nothing is to be done.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <elf.h>
#include <errno.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/types.h>
#include <sys/uio.h>

#define MOST (1 << 16) /* bytes; the kernel inside has one thread that traces, so each buffer is there once */

static long (*machine)(int, ...);
static char all[MOST];   /* what is set, with zeros behind it */
static size_t all_bytes; /* that this machine's kernel sets; 0: not needed so far */
static char read_last[MOST];
static size_t read_bytes;
static pid_t read_from; /* whose registers `read_last` are, until it runs; 0: nobody's */

static long set(pid_t pid, const struct iovec *known) {
  struct iovec whole = {all, sizeof all};
  if (pid == read_from && known->iov_len >= read_bytes && memcmp(known->iov_base, read_last, read_bytes) == 0)
    return 0;
  if (pid == read_from)
    read_from = 0;
  if (all_bytes == 0) {
    long status = machine(PTRACE_SETREGSET, pid, (void *)NT_X86_XSTATE, known);
    if (status == 0 || errno != EFAULT)
      return status;
    if (machine(PTRACE_GETREGSET, pid, (void *)NT_X86_XSTATE, &whole) != 0)
      return -1;
    all_bytes = whole.iov_len;
    memset(all, 0, sizeof all);
  }
  if (known->iov_len > all_bytes) {
    errno = EFAULT;
    return -1;
  }
  memcpy(all, known->iov_base, known->iov_len);
  whole.iov_len = all_bytes;
  return machine(PTRACE_SETREGSET, pid, (void *)NT_X86_XSTATE, &whole);
}

static long get(pid_t pid, const struct iovec *wanted) {
  long status = machine(PTRACE_GETREGSET, pid, (void *)NT_X86_XSTATE, wanted);
  if (status == 0 && wanted->iov_len <= sizeof read_last) {
    read_bytes = wanted->iov_len;
    memcpy(read_last, wanted->iov_base, read_bytes);
    read_from = pid;
  }
  return status;
}

long ptrace(enum __ptrace_request request, ...) {
  va_list arguments;
  pid_t pid;
  void *address, *data;
  va_start(arguments, request);
  pid = va_arg(arguments, pid_t);
  address = va_arg(arguments, void *);
  data = va_arg(arguments, void *);
  va_end(arguments);
  if (machine == NULL)
    machine = (long (*)(int, ...))dlsym(RTLD_NEXT, "ptrace");
  if ((uintptr_t)address == NT_X86_XSTATE && request == PTRACE_SETREGSET)
    return set(pid, data);
  if ((uintptr_t)address == NT_X86_XSTATE && request == PTRACE_GETREGSET)
    return get(pid, data);
  if (pid == read_from && request != PTRACE_GETREGS && request != PTRACE_SETREGS)
    read_from = 0; /* it may run, and change them */
  return machine(request, pid, address, data);
}
