/* The check at the end of every packet: BLAKE2s (RFC 7693) with a key. */
#ifndef WIRE_CHECK_H
#define WIRE_CHECK_H

#include <stddef.h>
#include <stdint.h>

enum { WIRE_TAG = 16, WIRE_KEY = 32 };

/* Write the 16 bytes for data of 1 byte or more, with a key of 1 to 32 bytes. */
void wire_check(const uint8_t *data, size_t length, const uint8_t *key, size_t key_length, uint8_t tag[WIRE_TAG]);

/* Whether `tag` is that of the data; takes the same time wherever they differ. */
int wire_is_sound(const uint8_t *data, size_t length, const uint8_t *key, size_t key_length,
                  const uint8_t tag[WIRE_TAG]);

#endif
