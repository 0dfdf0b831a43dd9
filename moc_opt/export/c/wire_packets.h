/* The packets of the wire, see docs/realtime.md. Little-endian machines only. */
#ifndef WIRE_PACKETS_H
#define WIRE_PACKETS_H

#include <stdint.h>

#include "wire_numbers.h"

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the packets are little-endian"
#endif

enum { WIRE_WAITING, WIRE_RUNNING, WIRE_ENDED }; /* flags of a measurement */
enum { WIRE_STOP = 1, WIRE_REPORTED = 2 };       /* flags of a command */

typedef struct {
    char magic[4];
    uint8_t version, kind, joints, flags;
    uint64_t session, scenario;
    int64_t sequence, sent_ns;
} wire_header;

typedef struct { /* HELLO and START */
    wire_header head;
    uint8_t tag[16];
} wire_plain;

typedef struct {
    wire_header head;
    int64_t stamp;
    double q[WIRE_JOINTS], v[WIRE_JOINTS], wrench[6], commanded[WIRE_JOINTS];
    uint32_t counters[WIRE_COUNTERS];
    uint8_t tag[16];
} wire_measurement;

typedef struct {
    wire_header head;
    double tau[WIRE_JOINTS], friction[WIRE_JOINTS], control_us;
    uint32_t limited, spare;
    char reason[96];
    uint8_t tag[16];
} wire_command;

typedef struct {
    wire_header head;
    double solve_us, x_rad_per_s[WIRE_JOINTS], applied_x_rad_per_s[WIRE_JOINTS], dual[6];
    double subproblem[11 * WIRE_JOINTS + 10];
    int32_t iterations;
    uint32_t spare;
    char status[16], fault[16];
    uint8_t tag[16];
} wire_report;

typedef struct {
    wire_header head;
    char words[3000];
    uint8_t tag[16];
} wire_bye;

_Static_assert(sizeof(wire_plain) == WIRE_HELLO_BYTES, "HELLO");
_Static_assert(sizeof(wire_measurement) == WIRE_MEASUREMENT_BYTES, "MEASUREMENT");
_Static_assert(sizeof(wire_command) == WIRE_COMMAND_BYTES, "COMMAND");
_Static_assert(sizeof(wire_report) == WIRE_REPORT_BYTES, "REPORT");
_Static_assert(sizeof(wire_bye) == WIRE_BYE_BYTES, "BYE");

#endif
