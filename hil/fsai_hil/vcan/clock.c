/* The clock that User-Mode Linux lacks.
 *
 * On any other Linux a program reads the time without entering the kernel: the vDSO scales the processor's time-stamp
 * counter. In User-Mode Linux every reading is a system call, which is dear there, and four of five system calls of a
 * ROS 2 node are readings of the clock. Preloaded (LD_PRELOAD), this library reads the counter as the vDSO would.
 *
 * The machine inside stays on one processor, so there is one counter. Its scale comes measured from outside, in the
 * environment. Twenty times a second the kernel's clock is asked again and the difference, some microseconds, is worked
 * off over the next such period, so that the time never steps nor runs backwards; the wall clock follows its steps.
 *
 * Where the machine inside skips its idle time (slow_clock.c), the counter does not: what was skipped so far stands in a
 * page that both sides map, FSAI_SKIPPED. While a program runs nothing is skipped.
 */
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define NS_PER_S 1000000000LL
#define PERIOD_NS 50000000LL
#define LOST_NS 1000000LL /* more than this is no inaccuracy: the counter stood still, or this process did not see it */

struct anchor {
  uint64_t counter;
  int64_t monotonic_ns;
  int64_t owed_ns;    /* what is to be made up over the period that begins here */
  int64_t realtime_ns; /* wall clock minus monotonic */
  int64_t skipped_ns;  /* by then */
};

static struct anchor anchors[2];
static atomic_uint generation; /* of the anchor in force: anchors[generation % 2]; 0 is none yet */
static atomic_flag asking = ATOMIC_FLAG_INIT;
static double ns_per_count;
static const _Atomic int64_t none_skipped;
static const _Atomic int64_t *skipped_ns = &none_skipped;

uint64_t fsai_counter(void) { return __builtin_ia32_rdtsc(); }

__attribute__((constructor)) static void start(void) {
  const char *scale = getenv("FSAI_NS_PER_COUNT");
  const char *skipped = getenv("FSAI_SKIPPED");
  ns_per_count = scale ? strtod(scale, NULL) : 0.0;
  if (skipped != NULL) {
    int device = open(skipped, O_RDONLY | O_CLOEXEC);
    void *page = mmap(NULL, sizeof *skipped_ns, PROT_READ, MAP_SHARED, device, 0);
    if (page == MAP_FAILED)
      ns_per_count = 0.0; /* the kernel knows better */
    else
      skipped_ns = page;
    close(device);
  }
}

static int64_t kernel_ns(clockid_t clock) {
  struct timespec now;
  syscall(SYS_clock_gettime, clock, &now);
  return now.tv_sec * NS_PER_S + now.tv_nsec;
}

static int64_t since(const struct anchor *anchor, uint64_t counter) {
  double elapsed_ns = (double)(int64_t)(counter - anchor->counter) * ns_per_count;
  double share = elapsed_ns / PERIOD_NS;
  return (int64_t)(elapsed_ns + (double)anchor->owed_ns * (share < 1.0 ? share : 1.0));
}

static void ask_kernel(unsigned current) {
  struct anchor *next = &anchors[(current + 1) % 2];
  uint64_t before = 0, after = 0;
  int64_t kernel = 0;
  /* Of three readings the one that was interrupted least. */
  for (int attempt = 0; attempt < 3; attempt++) {
    uint64_t from = fsai_counter();
    int64_t ns = kernel_ns(CLOCK_MONOTONIC), skipped = *skipped_ns;
    uint64_t to = fsai_counter();
    if (attempt == 0 || to - from < after - before) {
      before = from;
      after = to;
      kernel = ns;
      next->skipped_ns = skipped;
    }
  }
  next->counter = before + (after - before) / 2;
  next->monotonic_ns = kernel;
  next->owed_ns = 0;
  if (current) {
    const struct anchor *last = &anchors[current % 2];
    int64_t ours = last->monotonic_ns + since(last, next->counter) + next->skipped_ns - last->skipped_ns;
    int64_t behind = kernel - ours;
    if (behind < LOST_NS) {
      next->monotonic_ns = ours;
      next->owed_ns = behind < -LOST_NS ? -LOST_NS : behind;
    }
  }
  int64_t tightest = INT64_MAX;
  for (int attempt = 0; attempt < 3; attempt++) {
    int64_t from = kernel_ns(CLOCK_MONOTONIC), wall = kernel_ns(CLOCK_REALTIME), to = kernel_ns(CLOCK_MONOTONIC);
    if (to - from < tightest) {
      tightest = to - from;
      next->realtime_ns = wall - (from + to) / 2;
    }
  }
  atomic_store_explicit(&generation, current + 1, memory_order_release);
}

static int64_t now_ns(int wall_clock) {
  for (;;) {
    unsigned current = atomic_load_explicit(&generation, memory_order_acquire);
    struct anchor anchor = anchors[current % 2];
    uint64_t counter = fsai_counter();
    int64_t elapsed_ns = current ? since(&anchor, counter) + *skipped_ns - anchor.skipped_ns : 0;
    atomic_thread_fence(memory_order_acquire);
    if (atomic_load_explicit(&generation, memory_order_relaxed) != current)
      continue;
    if ((!current || elapsed_ns > PERIOD_NS) && !atomic_flag_test_and_set(&asking)) {
      if (atomic_load(&generation) == current)
        ask_kernel(current);
      atomic_flag_clear(&asking);
      continue;
    }
    if (!current) /* another thread is just asking for the first time */
      return kernel_ns(wall_clock ? CLOCK_REALTIME : CLOCK_MONOTONIC);
    return anchor.monotonic_ns + elapsed_ns + (wall_clock ? anchor.realtime_ns : 0);
  }
}

int clock_gettime(clockid_t clock, struct timespec *now) {
  if (ns_per_count <= 0.0 || (clock != CLOCK_MONOTONIC && clock != CLOCK_REALTIME))
    return (int)syscall(SYS_clock_gettime, clock, now);
  int64_t ns = now_ns(clock == CLOCK_REALTIME);
  now->tv_sec = ns / NS_PER_S;
  now->tv_nsec = ns % NS_PER_S;
  return 0;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone) {
  if (ns_per_count <= 0.0 || zone != NULL)
    return (int)syscall(SYS_gettimeofday, now, zone);
  int64_t ns = now_ns(1);
  now->tv_sec = ns / NS_PER_S;
  now->tv_usec = ns % NS_PER_S / 1000;
  return 0;
}
