// SHA-256 (FIPS 180-4), as sha256sum prints it: tells whether a file or a set of options changed.
#ifndef SHA256_H
#define SHA256_H

#include <stddef.h>
#include <stdint.h>

typedef struct sha256 {
    uint32_t state[8];
    uint64_t length; // bytes so far
    unsigned char block[64];
} sha256;

void sha256_begin(sha256 *hash);
void sha256_add(sha256 *hash, const void *bytes, size_t count);
// Lower-case hexadecimal digits.
void sha256_end(sha256 *hash, char text[65]);

#endif
