/* A CAN node of one's own, in the manner of the car's C library: the whole AI side in one loop.
 *
 *   cc -O2 -o own_can_node own_can_node.c
 *   ./own_can_node vcan0
 *
 * Every 10 ms it reads what waits and sends the five messages in the order of their ids. It drives what needs no
 * perception: static inspections A and B and the autonomous demo. In the other missions it stands with the brake held.
 *
 * `--fault NAME` puts one of the mistakes in that teams have made (`--faults` lists them): for
 * `fsai-vcu rehearse`, which names each of them. Never on a car.
 *
 * As a shared library it is for tests that bring their own bus and clock: `begin`, then `run_cycle` every 10 ms.
 */
#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <signal.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#define MS INT64_C(1000000)
#define S (1000 * MS)
#define PERIOD (10 * MS)
#define STALE (100 * MS)     /* what is older is not known any more */
#define LAUNCH (3 * S)       /* the car must not move so long after AS_DRIVING began */
#define REST (500 * MS)      /* wheels under 10 rpm for so long: the car stands */
#define GEAR 3.5             /* turns of the motor for one of the wheel */
#define RPM_PER_KMH 10.6     /* of a wheel with a radius of 0.25 m */
#define HOLD_PCT 20.0
#define STOP_PCT 40.0
#define MOST 64 /* frames of the car that are read at once */

enum { AS_INIT, AS_OFF, AS_READY, AS_DRIVING, EMERGENCY_BRAKE, AS_FINISHED };
enum { NOT_SELECTED, SELECTED, RUNNING, FINISHED };
enum { NEUTRAL, FORWARD };
enum { STATIC_A = 5, STATIC_B = 6, DEMO = 7 };

static const char *const faults[] = {
    "none", "inverted-echo", "late-echo", "stuck-echo", "slow-period", "no-brake-message", "short-steering",
    "reserved-id", "reverse-order", "selected-without-mission", "never-selected", "running-too-early",
    "never-running", "torque-before-go", "steering-before-go", "early-launch", "torque-and-brake", "one-call",
    "finished-rolling", "neutral-rolling", "front-axle", "torque-halved", "steering-too-far", "steering-swapped",
    "blind-to-status", "blind-to-wheels", "torque-in-emergency", "keeps-mission", "keeps-estop", "never-ends",
};
enum {
  NONE, INVERTED_ECHO, LATE_ECHO, STUCK_ECHO, SLOW_PERIOD, NO_BRAKE_MESSAGE, SHORT_STEERING,
  RESERVED_ID, REVERSE_ORDER, SELECTED_WITHOUT_MISSION, NEVER_SELECTED, RUNNING_TOO_EARLY,
  NEVER_RUNNING, TORQUE_BEFORE_GO, STEERING_BEFORE_GO, EARLY_LAUNCH, TORQUE_AND_BRAKE, ONE_CALL,
  FINISHED_ROLLING, NEUTRAL_ROLLING, FRONT_AXLE, TORQUE_HALVED, STEERING_TOO_FAR, STEERING_SWAPPED,
  BLIND_TO_STATUS, BLIND_TO_WHEELS, TORQUE_IN_EMERGENCY, KEEPS_MISSION, KEEPS_ESTOP, NEVER_ENDS,
};
static int fault = NONE;

/* ---------------------------------------------------------------- what the car says */

struct car {
  bool handshake, handshake_before; /* of the newest 0x520, and of the one before it */
  int as_state, ami;
  double angle_deg, angle_max_deg, front_max_nm, rear_max_nm; /* 0 Nm: an axle without a motor */
  int rpm[4];
  int64_t status_ns, steer_ns, rear_ns, speeds_ns; /* when each was received */
};

static int u16(const struct can_frame *frame, int at) { return frame->data[at] | frame->data[at + 1] << 8; }

static void receive(struct car *car, const struct can_frame *frame, int64_t now) {
  switch (frame->can_id) {
  case 0x520:
    car->handshake_before = car->handshake;
    car->handshake = frame->data[0] & 1;
    car->as_state = frame->data[2] & 0xF;
    car->ami = frame->data[2] >> 4;
    car->status_ns = now;
    break;
  case 0x521:
    car->front_max_nm = u16(frame, 4) * 0.1;
    break;
  case 0x522:
    car->rear_max_nm = u16(frame, 4) * 0.1;
    car->rear_ns = now;
    break;
  case 0x523:
    car->angle_deg = (int16_t)u16(frame, 0) * 0.1;
    car->angle_max_deg = u16(frame, 2) * 0.1;
    car->steer_ns = now;
    break;
  case 0x525:
    for (int wheel = 0; wheel < 4; wheel++)
      car->rpm[wheel] = u16(frame, 2 * wheel);
    car->speeds_ns = now;
    break;
  }
}

static int fastest_rpm(const struct car *car) {
  int most = 0;
  for (int wheel = 0; wheel < 4; wheel++)
    most = car->rpm[wheel] > most ? car->rpm[wheel] : most;
  return most;
}

static int slowest_rear_rpm(const struct car *car) { return car->rpm[2] < car->rpm[3] ? car->rpm[2] : car->rpm[3]; }

/* ---------------------------------------------------------------- what is asked of it */

struct command {
  bool handshake, estop;
  int mission_status, direction, motor_rpm;
  double front_nm, rear_nm, steer_deg, brake_pct;
};

struct mission {
  int ami;              /* latched when AS_DRIVING begins */
  int step;
  int64_t driving_ns;   /* since when */
  int64_t step_ns;      /* when this step began */
  int64_t turned_ns;    /* when a wheel turned last */
  bool estop;           /* asked for in this run */
  double torque_nm, brake_pct; /* of the last cycle */
};

static void next_step(struct mission *mission, int64_t now) {
  mission->step++;
  mission->step_ns = now;
}

/* Ask for an angle until the car has it, or has had time enough. */
static void steer_to(struct mission *mission, struct command *command, const struct car *car, double deg, int64_t now) {
  double off_deg = car->angle_deg - deg;
  command->steer_deg = deg;
  if ((off_deg < 1.0 && off_deg > -1.0 && now - mission->step_ns > 200 * MS) || now - mission->step_ns > 4 * S)
    next_step(mission, now);
}

static void speed_up(struct mission *mission, struct command *command, const struct car *car, int rpm, int64_t now) {
  command->front_nm = car->front_max_nm;
  command->rear_nm = car->rear_max_nm;
  command->motor_rpm = (int)(rpm * 1.15 * GEAR);
  if (slowest_rear_rpm(car) >= rpm)
    next_step(mission, now);
}

static void stop(struct mission *mission, struct command *command, int64_t now) {
  command->brake_pct = STOP_PCT;
  if (now - mission->turned_ns >= REST)
    next_step(mission, now);
}

static void finish(struct command *command) {
  command->mission_status = FINISHED;
  command->direction = NEUTRAL;
  command->brake_pct = HOLD_PCT;
}

static void drive(struct mission *mission, struct command *command, const struct car *car, int64_t now) {
  double most_deg = car->angle_max_deg, sweep_deg = 12.0;
  if (fault == STEERING_TOO_FAR)
    most_deg += 3.0;
  if (fault == STEERING_SWAPPED)
    most_deg = -most_deg, sweep_deg = -sweep_deg;
  if (mission->ami == STATIC_A)
    switch (mission->step) {
    case 0: steer_to(mission, command, car, most_deg, now); break;
    case 1: steer_to(mission, command, car, -most_deg, now); break;
    case 2: steer_to(mission, command, car, 0.0, now); break;
    case 3: speed_up(mission, command, car, 200, now); break;
    case 4: stop(mission, command, now); break;
    default: finish(command);
    }
  else if (mission->ami == STATIC_B)
    switch (mission->step) {
    case 0: speed_up(mission, command, car, 50, now); break;
    default: mission->estop = true;
    }
  else if (mission->ami == DEMO)
    switch (mission->step) {
    case 0: steer_to(mission, command, car, sweep_deg, now); break;
    case 1: steer_to(mission, command, car, -sweep_deg, now); break;
    case 2: steer_to(mission, command, car, 0.0, now); break;
    case 3: case 5: speed_up(mission, command, car, (int)(16.5 * RPM_PER_KMH), now); break;
    case 4: stop(mission, command, now); break;
    default: mission->estop = true;
    }
  else
    command->brake_pct = HOLD_PCT;
}

static bool stale(int64_t received_ns, int64_t now) { return now - received_ns > STALE; }

/* One cycle: what the car gets to hear now. Pure. */
static struct command decide(const struct car *car, struct mission *mission, int64_t now) {
  struct command command = {.handshake = car->handshake, .direction = NEUTRAL};
  bool status_lost = stale(car->status_ns, now) && fault != BLIND_TO_STATUS;
  bool wheels_lost = stale(car->speeds_ns, now) && fault != BLIND_TO_WHEELS;
  if (fastest_rpm(car) >= 10)
    mission->turned_ns = now;
  if (car->as_state != AS_DRIVING)
    mission->driving_ns = 0;
  switch (car->as_state) {
  case AS_READY:
    command.brake_pct = HOLD_PCT; /* and, as in AS_OFF, the mission is acknowledged */ /* fall through */
  case AS_INIT:
  case AS_OFF:
    if (fault != KEEPS_ESTOP)
      mission->estop = false;
    if (fault != KEEPS_MISSION || mission->ami == 0)
      mission->ami = car->ami;
    command.mission_status = car->ami != 0 ? SELECTED : NOT_SELECTED;
    break;
  case AS_DRIVING:
    if (mission->driving_ns == 0) {
      mission->driving_ns = mission->step_ns = now;
      mission->step = 0;
    }
    command.mission_status = RUNNING;
    command.direction = FORWARD;
    if (now - mission->driving_ns < LAUNCH && fault != EARLY_LAUNCH) {
      command.brake_pct = HOLD_PCT;
      mission->step_ns = now;
    } else if (!mission->estop)
      drive(mission, &command, car, now);
    if (status_lost || wheels_lost || stale(car->steer_ns, now) || stale(car->rear_ns, now))
      mission->estop = true; /* what the car does is not known any more */
    break;
  case AS_FINISHED:
    finish(&command);
    break;
  default: /* EMERGENCY_BRAKE: the car brakes by itself */
    command.mission_status = RUNNING;
    command.direction = fastest_rpm(car) >= 10 ? FORWARD : NEUTRAL;
  }
  command.estop = mission->estop;
  if (mission->estop)
    command.front_nm = command.rear_nm = command.brake_pct = 0.0;
  return command;
}

/* Torque and brake never meet at the VCU, which sees the messages one after another: between them goes a cycle with
 * both at zero. */
static void keep_apart(struct mission *mission, struct command *command) {
  if (fault != ONE_CALL && fault != TORQUE_AND_BRAKE &&
      ((command->rear_nm > 0.0 && mission->brake_pct > 0.0) || (command->brake_pct > 0.0 && mission->torque_nm > 0.0)))
    command->front_nm = command->rear_nm = command->brake_pct = 0.0;
  mission->torque_nm = command->rear_nm;
  mission->brake_pct = command->brake_pct;
}

static void make_mistake(const struct car *car, struct mission *mission, struct command *command) {
  bool driving = car->as_state == AS_DRIVING, rolls = fastest_rpm(car) > 50;
  switch (fault) {
  case INVERTED_ECHO: command->handshake = !car->handshake; break;
  case LATE_ECHO: command->handshake = car->handshake_before; break;
  case STUCK_ECHO: command->handshake = false; break;
  case SELECTED_WITHOUT_MISSION: if (car->as_state <= AS_OFF) command->mission_status = SELECTED; break;
  case NEVER_SELECTED: if (command->mission_status == SELECTED) command->mission_status = NOT_SELECTED; break;
  case RUNNING_TOO_EARLY: if (car->as_state == AS_READY) command->mission_status = RUNNING; break;
  case NEVER_RUNNING: if (command->mission_status == RUNNING) command->mission_status = SELECTED; break;
  case TORQUE_BEFORE_GO: if (car->as_state == AS_READY) command->rear_nm = 10.0, command->brake_pct = 0.0; break;
  case STEERING_BEFORE_GO: if (car->as_state == AS_READY) command->steer_deg = 2.0; break;
  case TORQUE_AND_BRAKE: if (command->rear_nm > 0.0) command->brake_pct = 5.0; break;
  case FINISHED_ROLLING: if (driving && rolls && command->brake_pct > 0.0) command->mission_status = FINISHED; break;
  case NEUTRAL_ROLLING: if (driving && rolls && command->brake_pct > 0.0) command->direction = NEUTRAL; break;
  case FRONT_AXLE: command->front_nm = command->rear_nm, command->rear_nm = 0.0; break;
  case TORQUE_HALVED: command->front_nm = command->rear_nm /= 2.0; break;
  case TORQUE_IN_EMERGENCY:
    if (car->as_state == EMERGENCY_BRAKE && mission->ami == STATIC_A)
      command->rear_nm = 50.0;
    break;
  }
}

/* ---------------------------------------------------------------- the five messages */

static void put_u16(struct can_frame *frame, int at, int value) {
  frame->data[at] = value & 0xFF;
  frame->data[at + 1] = value >> 8 & 0xFF;
}

static int encode(const struct command *command, struct can_frame frames[]) {
  static const unsigned char lengths[] = {8, 4, 4, 2, 2};
  memset(frames, 0, 6 * sizeof *frames);
  for (int i = 0; i < 5; i++) {
    frames[i].can_id = 0x510 + i;
    frames[i].can_dlc = lengths[i];
  }
  frames[0].data[0] = command->handshake;
  frames[0].data[1] = command->estop | command->mission_status << 4 | command->direction << 6;
  put_u16(&frames[1], 0, (int)(command->front_nm * 10.0 + 0.5));
  put_u16(&frames[1], 2, command->motor_rpm);
  put_u16(&frames[2], 0, (int)(command->rear_nm * 10.0 + 0.5));
  put_u16(&frames[2], 2, command->motor_rpm);
  put_u16(&frames[3], 0, (int)(command->steer_deg * 10.0 + (command->steer_deg < 0.0 ? -0.5 : 0.5)));
  frames[4].data[0] = frames[4].data[1] = (unsigned char)(command->brake_pct * 2.0 + 0.5);
  if (fault == SHORT_STEERING)
    frames[3].can_dlc = 1;
  if (fault == RESERVED_ID) {
    frames[5].can_id = 0x120;
    frames[5].can_dlc = 8;
    return 6;
  }
  if (fault == NO_BRAKE_MESSAGE)
    return 4;
  if (fault == REVERSE_ORDER)
    for (int i = 0; i < 2; i++) {
      struct can_frame first = frames[i];
      frames[i] = frames[4 - i];
      frames[4 - i] = first;
    }
  return 5;
}

/* ---------------------------------------------------------------- one cycle after the other */

static struct car car;
static struct mission mission;

/* A new process; false for a mistake that has no such name. */
bool begin(const char *mistake) {
  memset(&car, 0, sizeof car);
  memset(&mission, 0, sizeof mission);
  for (fault = 0; fault < (int)(sizeof faults / sizeof *faults); fault++)
    if (strcmp(mistake, faults[fault]) == 0)
      return true;
  return false;
}

/* What has been received since the last cycle goes in, what is sent comes out: up to six frames, their number returned.
 * `now` in ns of a clock that is never set. */
int run_cycle(const struct can_frame received[], int count, int64_t now, struct can_frame sent[]) {
  static bool slow;
  for (int i = 0; i < count; i++)
    receive(&car, &received[i], now);
  if (fault == SLOW_PERIOD && (slow = !slow))
    return 0;
  struct command command = decide(&car, &mission, now);
  keep_apart(&mission, &command);
  make_mistake(&car, &mission, &command);
  return encode(&command, sent);
}

/* ---------------------------------------------------------------- clock and bus */

static volatile sig_atomic_t ended;

static void end(int number) {
  (void)number;
  ended = fault != NEVER_ENDS;
}

static int64_t monotonic(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now); /* a step of the wall clock stops nothing */
  return now.tv_sec * S + now.tv_nsec;
}

static int on_bus(const char *name) {
  struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(name)};
  struct can_filter filter = {.can_id = 0x520, .can_mask = 0x7F8 | CAN_EFF_FLAG | CAN_RTR_FLAG}; /* 0x520 to 0x527 */
  int bus = socket(PF_CAN, SOCK_RAW, CAN_RAW);
  if (bus < 0 || address.can_ifindex == 0 ||
      setsockopt(bus, SOL_CAN_RAW, CAN_RAW_FILTER, &filter, sizeof filter) < 0 ||
      bind(bus, (struct sockaddr *)&address, sizeof address) < 0) {
    perror(name);
    return 1;
  }
  for (int64_t due = monotonic(); !ended;) {
    struct can_frame received[MOST], sent[6];
    struct timespec wake;
    int count = 0;
    due += PERIOD;
    if (monotonic() - due > PERIOD)
      due = monotonic(); /* held up: what was missed is not made up for */
    wake.tv_sec = due / S;
    wake.tv_nsec = due % S;
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &wake, NULL);
    while (count < MOST && recv(bus, &received[count], sizeof *received, MSG_DONTWAIT) == sizeof *received)
      count++;
    count = run_cycle(received, count, monotonic(), sent);
    for (int i = 0; i < count; i++)
      if (write(bus, &sent[i], sizeof sent[i]) != sizeof sent[i])
        break; /* the queue is full: half a cycle is no cycle, and the next one tries again */
  }
  return 0;
}

int main(int count, char **words) {
  if (count == 2 && strcmp(words[1], "--faults") == 0) {
    for (unsigned i = 1; i < sizeof faults / sizeof *faults; i++)
      puts(faults[i]);
    return 0;
  }
  if (!(count == 2 && begin("none")) && !(count == 4 && strcmp(words[2], "--fault") == 0 && begin(words[3]))) {
    fprintf(stderr, "usage: %s BUS [--fault NAME], or --faults for the names\n", words[0]);
    return 2;
  }
  signal(SIGINT, end);
  signal(SIGTERM, end);
  return on_bus(words[1]);
}
