/* A clock that runs slower than the machine's, for User-Mode Linux on a machine too slow for real time.
 *
 * The kernel inside is an ordinary program here: it asks this machine's C library for the time and for the timer that
 * ticks for it. Preloaded (LD_PRELOAD), this library lets the monotonic clock advance by one second where FSAI_PACE
 * seconds pass, and lets timers take as much longer. So all that is inside has FSAI_PACE times the processor for the
 * same deadline, and cannot tell.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdint.h>
#include <stdlib.h>
#include <time.h>

#define NS_PER_S 1000000000LL

static int (*machine_gettime)(clockid_t, struct timespec *);
static int (*machine_settime)(timer_t, int, const struct itimerspec *, struct itimerspec *);
static int64_t began_ns;
static double pace = 1.0;

static int64_t nanoseconds(const struct timespec *time) { return time->tv_sec * NS_PER_S + time->tv_nsec; }

static struct timespec timespec_of(int64_t ns) {
  return (struct timespec){.tv_sec = ns / NS_PER_S, .tv_nsec = ns % NS_PER_S};
}

__attribute__((constructor)) static void start(void) {
  const char *wanted = getenv("FSAI_PACE");
  struct timespec now;
  machine_gettime = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
  machine_settime =
      (int (*)(timer_t, int, const struct itimerspec *, struct itimerspec *))dlsym(RTLD_NEXT, "timer_settime");
  if (wanted != NULL)
    pace = strtod(wanted, NULL);
  machine_gettime(CLOCK_MONOTONIC, &now);
  began_ns = nanoseconds(&now);
}

int clock_gettime(clockid_t clock, struct timespec *now) {
  int status = machine_gettime(clock, now);
  /* The wall clock is asked for once, at boot; from then on the kernel inside goes by the monotonic one. */
  if (status == 0 && clock == CLOCK_MONOTONIC)
    *now = timespec_of(began_ns + (int64_t)((double)(nanoseconds(now) - began_ns) / pace));
  return status;
}

/* What was left of the timer before is told in the machine's time; the kernel inside never asks for it. */
int timer_settime(timer_t timer, int flags, const struct itimerspec *slow, struct itimerspec *before) {
  struct itimerspec own = {
      .it_interval = timespec_of((int64_t)((double)nanoseconds(&slow->it_interval) * pace)),
      .it_value = timespec_of((int64_t)((double)nanoseconds(&slow->it_value) * pace)),
  };
  return machine_settime(timer, flags, &own, before);
}
