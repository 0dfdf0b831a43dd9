#define _POSIX_C_SOURCE 200809L
#include "wire_link.h"

#include <arpa/inet.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <time.h>

enum { REMEMBERED = 64, TURN_US = 50000 };

int64_t wire_now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

const char *wire_open(wire_link *link, const char *host, const char *port)
{
    struct timeval turn = {.tv_usec = TURN_US}; /* a call that waits comes back so often, to look at the clock */
    char *end;
    long number = strtol(port, &end, 10);

    memset(&link->plant, 0, sizeof link->plant);
    link->plant.sin_family = AF_INET;
    if (*end || number < 1 || number > 65535 || inet_pton(AF_INET, host, &link->plant.sin_addr) != 1)
        return "give HOST PORT as numbers: 127.0.0.1 30200";
    link->plant.sin_port = htons((uint16_t)number);
    link->socket = socket(AF_INET, SOCK_DGRAM, 0);
    if (link->socket < 0 || setsockopt(link->socket, SOL_SOCKET, SO_RCVTIMEO, &turn, sizeof turn) != 0)
        return "the system gives no socket";
    link->newest = -1;
    return NULL;
}

void wire_send(wire_link *link, wire_header *packet, size_t size, int kind, int64_t number)
{
    uint8_t *bytes = (uint8_t *)packet;

    memcpy(packet->magic, WIRE_MAGIC, sizeof packet->magic);
    packet->version = WIRE_VERSION;
    packet->kind = (uint8_t)kind;
    packet->joints = WIRE_JOINTS;
    packet->session = link->session;
    packet->scenario = WIRE_SCENARIO;
    packet->sequence = number;
    packet->sent_ns = wire_now_ns();
    wire_check(bytes, size - WIRE_TAG, link->key, link->key_length, bytes + size - WIRE_TAG);
    (void)!sendto(link->socket, packet, size, 0, (const struct sockaddr *)&link->plant, sizeof link->plant);
}

/* What is wrong with a datagram, as a counter; -1: nothing. */
static int judge(const wire_link *link, const uint8_t *bytes, size_t size, const struct sockaddr_in *sender)
{
    const wire_header *head = (const wire_header *)bytes;

    if (size != sizeof(wire_measurement) || head->kind != WIRE_KIND_MEASUREMENT)
        return WIRE_TRUNCATED;
    if (!wire_is_sound(bytes, size - WIRE_TAG, link->key, link->key_length, bytes + size - WIRE_TAG))
        return WIRE_FORGED;
    if (memcmp(head->magic, WIRE_MAGIC, sizeof head->magic) || head->version != WIRE_VERSION ||
        head->joints != WIRE_JOINTS || (link->session && head->session != link->session))
        return WIRE_FOREIGN;
    if (sender->sin_addr.s_addr != link->plant.sin_addr.s_addr || sender->sin_port != link->plant.sin_port)
        return WIRE_FOREIGN;
    return -1;
}

int wire_receive(wire_link *link, int64_t until, wire_measurement *found)
{
    do {
        struct sockaddr_in sender;
        socklen_t length = sizeof sender;
        union { /* one byte more than fits: a longer datagram is not cut to a sound one */
            wire_measurement packet;
            uint8_t bytes[sizeof(wire_measurement) + 1];
        } scratch;
        ssize_t size = recvfrom(link->socket, &scratch, sizeof scratch, 0, (struct sockaddr *)&sender, &length);
        if (size < 0)
            continue; /* the turn is over, or nobody listened where the last packet went */
        int wrong = judge(link, scratch.bytes, (size_t)size, &sender);
        if (wrong < 0) {
            *found = scratch.packet;
            return 1;
        }
        link->counts[wrong]++;
    } while (wire_now_ns() < until);
    return 0;
}

int wire_is_new(wire_link *link, const wire_measurement *found)
{
    int64_t number = found->head.sequence, back = link->newest - number;

    if (found->head.flags != WIRE_RUNNING || number < 0 || number >= WIRE_TICKS) {
        link->counts[WIRE_FOREIGN]++;
        return 0;
    }
    if (back < 0) {
        link->counts[WIRE_RECEIVED]++;
        link->counts[WIRE_MISSED] += (uint32_t)(-back - 1);
        link->seen = -back < REMEMBERED ? link->seen << -back | 1 : 1;
        link->newest = number;
        return 1;
    }
    if (back >= REMEMBERED)
        link->counts[WIRE_LATE]++;
    else if (link->seen >> back & 1)
        link->counts[WIRE_DOUBLED]++;
    else {
        link->counts[WIRE_REORDERED]++;
        link->seen |= (uint64_t)1 << back;
    }
    return back == 0 ? -1 : 0;
}
