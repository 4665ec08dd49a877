#include "sha256.h"

#include <stdio.h>
#include <string.h>

static const uint32_t first_state[8] = {0x6a09e667, 0xbb67ae85, 0x3c6ef372, 0xa54ff53a,
                                        0x510e527f, 0x9b05688c, 0x1f83d9ab, 0x5be0cd19};

static const uint32_t constants[64] = {
    0x428a2f98, 0x71374491, 0xb5c0fbcf, 0xe9b5dba5, 0x3956c25b, 0x59f111f1, 0x923f82a4, 0xab1c5ed5,
    0xd807aa98, 0x12835b01, 0x243185be, 0x550c7dc3, 0x72be5d74, 0x80deb1fe, 0x9bdc06a7, 0xc19bf174,
    0xe49b69c1, 0xefbe4786, 0x0fc19dc6, 0x240ca1cc, 0x2de92c6f, 0x4a7484aa, 0x5cb0a9dc, 0x76f988da,
    0x983e5152, 0xa831c66d, 0xb00327c8, 0xbf597fc7, 0xc6e00bf3, 0xd5a79147, 0x06ca6351, 0x14292967,
    0x27b70a85, 0x2e1b2138, 0x4d2c6dfc, 0x53380d13, 0x650a7354, 0x766a0abb, 0x81c2c92e, 0x92722c85,
    0xa2bfe8a1, 0xa81a664b, 0xc24b8b70, 0xc76c51a3, 0xd192e819, 0xd6990624, 0xf40e3585, 0x106aa070,
    0x19a4c116, 0x1e376c08, 0x2748774c, 0x34b0bcb5, 0x391c0cb3, 0x4ed8aa4a, 0x5b9cca4f, 0x682e6ff3,
    0x748f82ee, 0x78a5636f, 0x84c87814, 0x8cc70208, 0x90befffa, 0xa4506ceb, 0xbef9a3f7, 0xc67178f2};

static uint32_t rotate(uint32_t word, unsigned bits) { return word >> bits | word << (32 - bits); }

static void take_block(sha256 *hash, const unsigned char *block) {
    uint32_t w[64];
    for (size_t i = 0; i < 16; ++i) {
        const unsigned char *b = block + 4 * i;
        w[i] = (uint32_t)b[0] << 24 | (uint32_t)b[1] << 16 | (uint32_t)b[2] << 8 | b[3];
    }
    for (size_t i = 16; i < 64; ++i) {
        const uint32_t early = w[i - 15], late = w[i - 2];
        w[i] = w[i - 16] + (rotate(early, 7) ^ rotate(early, 18) ^ early >> 3) + w[i - 7] +
               (rotate(late, 17) ^ rotate(late, 19) ^ late >> 10);
    }
    const uint32_t *s = hash->state;
    uint32_t a = s[0], b = s[1], c = s[2], d = s[3], e = s[4], f = s[5], g = s[6], h = s[7];
    for (size_t i = 0; i < 64; ++i) {
        const uint32_t t1 = h + (rotate(e, 6) ^ rotate(e, 11) ^ rotate(e, 25)) +
                            ((e & f) ^ (~e & g)) + constants[i] + w[i];
        const uint32_t t2 =
            (rotate(a, 2) ^ rotate(a, 13) ^ rotate(a, 22)) + ((a & b) ^ (a & c) ^ (b & c));
        h = g, g = f, f = e, e = d + t1;
        d = c, c = b, b = a, a = t1 + t2;
    }
    const uint32_t end[8] = {a, b, c, d, e, f, g, h};
    for (size_t i = 0; i < 8; ++i) {
        hash->state[i] += end[i];
    }
}

void sha256_begin(sha256 *hash) {
    memcpy(hash->state, first_state, sizeof(first_state));
    hash->length = 0;
}

void sha256_add(sha256 *hash, const void *bytes, size_t count) {
    const unsigned char *at = bytes;
    while (count > 0) {
        const size_t used = hash->length % 64;
        const size_t taken = count < 64 - used ? count : 64 - used;
        memcpy(hash->block + used, at, taken);
        hash->length += taken;
        at += taken;
        count -= taken;
        if (used + taken == 64) {
            take_block(hash, hash->block);
        }
    }
}

void sha256_end(sha256 *hash, char text[65]) {
    const uint64_t bits = 8 * hash->length;
    const unsigned char one = 0x80, zero = 0;
    sha256_add(hash, &one, 1);
    while (hash->length % 64 != 56) {
        sha256_add(hash, &zero, 1);
    }
    unsigned char size[8];
    for (unsigned i = 0; i < 8; ++i) {
        size[i] = (unsigned char)(bits >> (56 - 8 * i));
    }
    sha256_add(hash, size, sizeof(size));
    for (size_t i = 0; i < 8; ++i) {
        snprintf(text + 8 * i, 9, "%08x", (unsigned)hash->state[i]);
    }
}
