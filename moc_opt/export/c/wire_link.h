/* The controller's end of the wire: a UDP socket that lets only sound measurements through, and counts the rest. */
#ifndef WIRE_LINK_H
#define WIRE_LINK_H

#include <netinet/in.h>

#include "wire_check.h"
#include "wire_packets.h"

typedef struct {
    int socket;
    struct sockaddr_in plant;
    uint8_t key[WIRE_KEY];
    size_t key_length;
    uint64_t session; /* 0 until the plant has told it */
    uint32_t counts[WIRE_COUNTERS];
    int64_t newest; /* number of the newest measurement that was taken */
    uint64_t seen;  /* bit i: number newest - i has come */
} wire_link;

/* A steady clock [ns]. */
int64_t wire_now_ns(void);

/* Begin to speak with host:port. Returns NULL, or what is wrong. */
const char *wire_open(wire_link *link, const char *host, const char *port);

/* Fill the header of a packet, seal it and send it; one that the system does not take is lost. */
void wire_send(wire_link *link, wire_header *packet, size_t size, int kind, int64_t number);

/* The next sound measurement, waiting until `until` [ns]; 0 where none has come. */
int wire_receive(wire_link *link, int64_t until, wire_measurement *found);

/* Judge and count a measurement of a run: 1 where it is new, -1 for the newest once more, 0 for all else. */
int wire_is_new(wire_link *link, const wire_measurement *found);

#endif
