/* A clock for User-Mode Linux that gives what is inside as much processor as it needs, on any machine.
 *
 * The kernel inside is an ordinary program here: it asks this machine's C library for the time and for the timer that
 * ticks for it, and it suspends itself where it has nothing to do. Preloaded (LD_PRELOAD), this library lets the
 * monotonic clock advance by one second where FSAI_PACE seconds of work pass, and lets timers take as much longer. So all
 * that is inside has FSAI_PACE times the processor for the same deadline, and cannot tell.
 *
 * With FSAI_SKIPPED, a file, idle time takes none: where the kernel suspends itself until its next timer, the clock goes
 * there at once. All time skipped so far is in the file, for the programs inside that read a clock without the kernel.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <time.h>

#define NS_PER_S 1000000000LL

static int (*machine_gettime)(clockid_t, struct timespec *);
static int (*machine_settime)(timer_t, int, const struct itimerspec *, struct itimerspec *);
static int (*machine_suspend)(const sigset_t *);
static int64_t began_ns;
static double pace = 1.0;
static timer_t ticking;
static int ticks;                    /* whether there is that timer */
static _Atomic int64_t none_skipped; /* stays 0 */
static _Atomic int64_t *skipped_ns = &none_skipped; /* by the clock inside */

static int64_t nanoseconds(const struct timespec *time) { return time->tv_sec * NS_PER_S + time->tv_nsec; }

static struct timespec timespec_of(int64_t ns) {
  return (struct timespec){.tv_sec = ns / NS_PER_S, .tv_nsec = ns % NS_PER_S};
}

__attribute__((constructor)) static void start(void) {
  const char *wanted = getenv("FSAI_PACE"), *path = getenv("FSAI_SKIPPED");
  struct timespec now;
  machine_gettime = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
  machine_settime =
      (int (*)(timer_t, int, const struct itimerspec *, struct itimerspec *))dlsym(RTLD_NEXT, "timer_settime");
  machine_suspend = (int (*)(const sigset_t *))dlsym(RTLD_NEXT, "sigsuspend");
  if (wanted != NULL)
    pace = strtod(wanted, NULL);
  if (path != NULL) {
    int file = open(path, O_RDWR | O_CLOEXEC);
    void *page = mmap(NULL, sizeof *skipped_ns, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (page == MAP_FAILED)
      abort(); /* the clocks inside would differ */
    skipped_ns = page;
  }
  machine_gettime(CLOCK_MONOTONIC, &now);
  began_ns = nanoseconds(&now);
}

int clock_gettime(clockid_t clock, struct timespec *now) {
  int status = machine_gettime(clock, now);
  /* The wall clock is asked for once, at boot; from then on the kernel inside goes by the monotonic one. */
  if (status == 0 && clock == CLOCK_MONOTONIC)
    *now = timespec_of(began_ns + (int64_t)((double)(nanoseconds(now) - began_ns) / pace) + *skipped_ns);
  return status;
}

/* What was left of the timer before is told in the machine's time; the kernel inside never asks for it. */
int timer_settime(timer_t timer, int flags, const struct itimerspec *slow, struct itimerspec *before) {
  struct itimerspec own = {
      .it_interval = timespec_of((int64_t)((double)nanoseconds(&slow->it_interval) * pace)),
      .it_value = timespec_of((int64_t)((double)nanoseconds(&slow->it_value) * pace)),
  };
  ticking = timer;
  ticks = 1;
  return machine_settime(timer, flags, &own, before);
}

int sigsuspend(const sigset_t *mask) {
  struct itimerspec left;
  sigset_t all, before;
  int status;
  /* Nothing sets the timer again between the look at it and the sleep. */
  sigfillset(&all);
  sigprocmask(SIG_SETMASK, &all, &before);
  if (skipped_ns != &none_skipped && ticks && timer_gettime(ticking, &left) == 0) {
    int64_t left_ns = nanoseconds(&left.it_value);
    if (left_ns > 0) {
      left.it_value = timespec_of(1);
      machine_settime(ticking, 0, &left, NULL);
      *skipped_ns += (int64_t)((double)left_ns / pace);
    }
  }
  status = machine_suspend(mask);
  sigprocmask(SIG_SETMASK, &before, NULL);
  return status;
}
