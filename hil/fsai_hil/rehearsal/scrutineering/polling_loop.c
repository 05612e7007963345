/* A peer to measure against: an AI computer's CAN loop as the car's C library has its user write it.
 *
 * Every 10 ms, by a relative sleep, it reads what waits and sends the five frames, with the HANDSHAKE bit of the newest
 * 0x520. It drives nothing: all else is zero, which is what is sent in AS_OFF. It runs at normal priority.
 *
 *   c-loop vcan0
 */
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define STATUS 0x520
#define FIRST 0x510

static const unsigned char lengths[] = {8, 4, 4, 2, 2}; /* of 0x510 to 0x514, as in the DBC files */
static const struct timespec period = {.tv_sec = 0, .tv_nsec = 10000000};

int main(int count, char **words) {
  struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = count == 2 ? if_nametoindex(words[1]) : 0};
  struct can_filter filter = {.can_id = STATUS, .can_mask = CAN_SFF_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG};
  int bus = socket(PF_CAN, SOCK_RAW, CAN_RAW);
  unsigned char handshake = 0;
  if (address.can_ifindex == 0 || bus < 0 ||
      setsockopt(bus, SOL_CAN_RAW, CAN_RAW_FILTER, &filter, sizeof filter) < 0 ||
      bind(bus, (struct sockaddr *)&address, sizeof address) < 0) {
    perror("c-loop");
    return 1;
  }
  for (;;) {
    struct can_frame frame;
    nanosleep(&period, NULL);
    while (recv(bus, &frame, sizeof frame, MSG_DONTWAIT) == sizeof frame)
      handshake = frame.data[0] & 1;
    for (unsigned i = 0; i < sizeof lengths; i++) {
      memset(&frame, 0, sizeof frame);
      frame.can_id = FIRST + i;
      frame.can_dlc = lengths[i];
      if (i == 0)
        frame.data[0] = handshake;
      if (write(bus, &frame, sizeof frame) != sizeof frame)
        perror("c-loop"); /* a full queue: the next cycle tries again */
    }
  }
}
