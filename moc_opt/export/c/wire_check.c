#include "wire_check.h"

#include <string.h>

enum { BLOCK = 64, ROUNDS = 10 };

static const uint32_t start[8] = {0x6A09E667u, 0xBB67AE85u, 0x3C6EF372u, 0xA54FF53Au,
                                  0x510E527Fu, 0x9B05688Cu, 0x1F83D9ABu, 0x5BE0CD19u};
static const uint8_t order[ROUNDS][16] = {
    {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15}, {14, 10, 4, 8, 9, 15, 13, 6, 1, 12, 0, 2, 11, 7, 5, 3},
    {11, 8, 12, 0, 5, 2, 15, 13, 10, 14, 3, 6, 7, 1, 9, 4}, {7, 9, 3, 1, 13, 12, 11, 14, 2, 6, 5, 10, 4, 0, 15, 8},
    {9, 0, 5, 7, 2, 4, 10, 15, 14, 1, 11, 12, 6, 8, 3, 13}, {2, 12, 6, 10, 0, 11, 8, 3, 4, 13, 7, 5, 15, 14, 1, 9},
    {12, 5, 1, 15, 14, 13, 4, 10, 0, 7, 6, 3, 9, 2, 8, 11}, {13, 11, 7, 14, 12, 1, 3, 9, 5, 0, 15, 4, 8, 6, 2, 10},
    {6, 15, 14, 9, 11, 3, 0, 8, 12, 2, 13, 7, 1, 4, 10, 5}, {10, 2, 8, 4, 7, 6, 1, 5, 15, 11, 9, 14, 3, 12, 13, 0},
};

static uint32_t turned(uint32_t x, int bits)
{
    return x >> bits | x << (32 - bits);
}

static void mix(uint32_t v[16], int a, int b, int c, int d, uint32_t x, uint32_t y)
{
    v[a] += v[b] + x;
    v[d] = turned(v[d] ^ v[a], 16);
    v[c] += v[d];
    v[b] = turned(v[b] ^ v[c], 12);
    v[a] += v[b] + y;
    v[d] = turned(v[d] ^ v[a], 8);
    v[c] += v[d];
    v[b] = turned(v[b] ^ v[c], 7);
}

/* One block into the state, after `count` bytes with it; the last one is marked. */
static void compress(uint32_t h[8], const uint8_t block[BLOCK], size_t count, int last)
{
    uint32_t v[16], m[16];

    for (int i = 0; i < 16; i++) {
        const uint8_t *at = block + 4 * i;
        m[i] = (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
        v[i] = i < 8 ? h[i] : start[i - 8];
    }
    v[12] ^= (uint32_t)count; /* packets have fewer than 2^32 bytes */
    if (last)
        v[14] = ~v[14];
    for (int r = 0; r < ROUNDS; r++) {
        const uint8_t *s = order[r];
        for (int i = 0; i < 4; i++)
            mix(v, i, 4 + i, 8 + i, 12 + i, m[s[2 * i]], m[s[2 * i + 1]]);
        for (int i = 0; i < 4; i++)
            mix(v, i, 4 + (i + 1) % 4, 8 + (i + 2) % 4, 12 + (i + 3) % 4, m[s[8 + 2 * i]], m[s[9 + 2 * i]]);
    }
    for (int i = 0; i < 8; i++)
        h[i] ^= v[i] ^ v[i + 8];
}

void wire_check(const uint8_t *data, size_t length, const uint8_t *key, size_t key_length, uint8_t tag[WIRE_TAG])
{
    uint32_t h[8];
    uint8_t block[BLOCK] = {0};
    size_t done = 0;

    memcpy(h, start, sizeof h);
    h[0] ^= 0x01010000u ^ (uint32_t)key_length << 8 ^ (uint32_t)WIRE_TAG;
    memcpy(block, key, key_length);
    compress(h, block, BLOCK, 0);
    for (; length - done > BLOCK; done += BLOCK)
        compress(h, data + done, BLOCK + done + BLOCK, 0);
    memset(block, 0, BLOCK);
    memcpy(block, data + done, length - done);
    compress(h, block, BLOCK + length, 1);
    for (int i = 0; i < WIRE_TAG; i++)
        tag[i] = (uint8_t)(h[i / 4] >> 8 * (i % 4));
}

int wire_is_sound(const uint8_t *data, size_t length, const uint8_t *key, size_t key_length,
                  const uint8_t tag[WIRE_TAG])
{
    uint8_t own[WIRE_TAG], differ = 0;

    wire_check(data, length, key, key_length, own);
    for (int i = 0; i < WIRE_TAG; i++)
        differ = (uint8_t)(differ | (own[i] ^ tag[i]));
    return differ == 0;
}
