// Positions: a register holds four vertices by (x, y, z, unused). Normals: a register holds the
// columns of one matrix.
#include <immintrin.h>

#include "deform_kernel.h"

enum { AHEAD = 4096 }; // bytes of the stream that are asked for in advance

static inline const float *floats(const char *at) { return (const float *)(const void *)at; }
static inline const uint16_t *shorts(const char *at) { return (const uint16_t *)(const void *)at; }

// One 16-byte row of a table for each of four vertices.
static inline __m512 gather(const float *table, const uint16_t *joints, size_t k) {
    const __m128 first = _mm_loadu_ps(&table[4 * (size_t)joints[k]]);
    const __m128 second = _mm_loadu_ps(&table[4 * (size_t)joints[k + 4]]);
    const __m128 third = _mm_loadu_ps(&table[4 * (size_t)joints[k + 8]]);
    const __m128 fourth = _mm_loadu_ps(&table[4 * (size_t)joints[k + 12]]);
    const __m512 lower = _mm512_insertf32x4(_mm512_castps128_ps512(first), second, 1);
    return _mm512_mask_broadcast_f32x4(_mm512_mask_broadcast_f32x4(lower, 0x0f00, third), 0xf000,
                                       fourth);
}

static inline void store(char *output, __m128 value) {
    _mm_storel_pi((__m64 *)(void *)output, value);
    _mm_store_ss((float *)(void *)(output + 8), _mm_movehl_ps(value, value));
}

// Stores the lanes of sixteen vertices; tightly packed they are three whole registers.
static inline void store_block(char *output, size_t stride, const __m512 value[4]) {
    if (stride == 12) {
        const __m512i first =
            _mm512_setr_epi32(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 16, 17, 18, 20);
        const __m512i second =
            _mm512_setr_epi32(5, 6, 8, 9, 10, 12, 13, 14, 16, 17, 18, 20, 21, 22, 24, 25);
        const __m512i third =
            _mm512_setr_epi32(10, 12, 13, 14, 16, 17, 18, 20, 21, 22, 24, 25, 26, 28, 29, 30);
        _mm512_storeu_ps(output, _mm512_permutex2var_ps(value[0], first, value[1]));
        _mm512_storeu_ps(output + 64, _mm512_permutex2var_ps(value[1], second, value[2]));
        _mm512_storeu_ps(output + 128, _mm512_permutex2var_ps(value[2], third, value[3]));
        return;
    }
    for (size_t i = 0; i < 4; ++i, output += 4 * stride) {
        store(output, _mm512_castps512_ps128(value[i]));
        store(output + stride, _mm512_extractf32x4_ps(value[i], 1));
        store(output + 2 * stride, _mm512_extractf32x4_ps(value[i], 2));
        store(output + 3 * stride, _mm512_extractf32x4_ps(value[i], 3));
    }
}

// Four influences of four vertices more.
static inline __m512 add_set(__m512 sum, const float *weights, const uint16_t *joints,
                             const float *table) {
    const __m512 w = _mm512_load_ps(weights);
    sum = _mm512_add_ps(sum, _mm512_mul_ps(_mm512_permute_ps(w, 0x00), gather(table, joints, 0)));
    sum = _mm512_add_ps(sum, _mm512_mul_ps(_mm512_permute_ps(w, 0x55), gather(table, joints, 1)));
    sum = _mm512_add_ps(sum, _mm512_mul_ps(_mm512_permute_ps(w, 0xaa), gather(table, joints, 2)));
    return _mm512_add_ps(sum, _mm512_mul_ps(_mm512_permute_ps(w, 0xff), gather(table, joints, 3)));
}

// rest + sum w d of four vertices of a block.
static inline __m512 pose_four(const char *block, size_t size, const float *table, size_t q) {
    const __m512i spread = _mm512_setr_epi32(0, 1, 2, 2, 3, 4, 5, 5, 6, 7, 8, 8, 9, 10, 11, 11);
    const char *set = block + PCI_DEFORM_REST;
    __m512 sum = _mm512_permutexvar_ps(spread, _mm512_loadu_ps(block + 48 * q));
    do {
        sum = add_set(sum, floats(set) + 16 * q, shorts(set + PCI_DEFORM_WEIGHTS) + 16 * q, table);
        set += PCI_DEFORM_SET_BYTES;
    } while (set < block + size);
    return sum;
}

static void positions(const pci_deform_rows *rows, const float *displacements, size_t begin,
                      size_t end, char *output, size_t stride) {
    const pci_deform_span span = pci_deform_whole_blocks(begin, end);
    const size_t size = pci_deform_block_bytes(rows);
    const char *block = rows->blocks + span.first * size;
    char *out = output + PCI_DEFORM_BLOCK * span.first * stride;
    pci_deform_generic.positions(rows, displacements, begin, span.head, output, stride);
    for (size_t b = span.first; b < span.last; ++b, block += size) {
        for (size_t line = 0; line < size; line += 64) {
            _mm_prefetch(block + AHEAD + line, _MM_HINT_T0);
        }
        const __m512 sums[4] = {
            pose_four(block, size, displacements, 0), pose_four(block, size, displacements, 1),
            pose_four(block, size, displacements, 2), pose_four(block, size, displacements, 3)};
        store_block(out, stride, sums);
        out += PCI_DEFORM_BLOCK * stride;
    }
    pci_deform_generic.positions(rows, displacements, span.tail, end, output, stride);
}

// sum w (R, t) of vertex i of a block, each column times one of four numbers.
static inline __m512 turn_columns(const char *block, size_t size, const float *maps, size_t i,
                                  __m128 numbers) {
    const __m512i spread = _mm512_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
    __m512 sum = _mm512_setzero_ps();
    for (const char *set = block + PCI_DEFORM_REST; set < block + size;
         set += PCI_DEFORM_SET_BYTES) {
        const float *w = floats(set) + 4 * i;
        const uint16_t *joint = shorts(set + PCI_DEFORM_WEIGHTS) + 4 * i;
        for (size_t k = 0; k < PCI_DEFORM_SET; ++k) {
            const __m512 columns = _mm512_load_ps(&maps[16 * (size_t)joint[k]]);
            sum = _mm512_add_ps(sum, _mm512_mul_ps(_mm512_set1_ps(w[k]), columns));
        }
    }
    return _mm512_mul_ps(sum, _mm512_permutexvar_ps(spread, _mm512_castps128_ps512(numbers)));
}

// sum w (R rest + t) of vertex i of a block.
static inline __m128 map_point(const char *block, size_t size, const float *maps, size_t i) {
    const float *p = floats(block) + 3 * i;
    const __m512 sum = turn_columns(block, size, maps, i, _mm_setr_ps(p[0], p[1], p[2], 1.0F));
    return _mm_add_ps(_mm_add_ps(_mm512_castps512_ps128(sum), _mm512_extractf32x4_ps(sum, 1)),
                      _mm_add_ps(_mm512_extractf32x4_ps(sum, 2), _mm512_extractf32x4_ps(sum, 3)));
}

static void affine(const pci_deform_rows *rows, const float *maps, size_t begin, size_t end,
                   char *output, size_t stride) {
    const pci_deform_span span = pci_deform_whole_blocks(begin, end);
    const size_t size = pci_deform_block_bytes(rows);
    pci_deform_generic.affine(rows, maps, begin, span.head, output, stride);
    for (size_t b = span.first; b < span.last; ++b) {
        const char *block = rows->blocks + b * size;
        __m512 sums[4];
        for (size_t q = 0; q < 4; ++q) {
            sums[q] = _mm512_castps128_ps512(map_point(block, size, maps, 4 * q));
            sums[q] = _mm512_insertf32x4(sums[q], map_point(block, size, maps, 4 * q + 1), 1);
            sums[q] = _mm512_insertf32x4(sums[q], map_point(block, size, maps, 4 * q + 2), 2);
            sums[q] = _mm512_insertf32x4(sums[q], map_point(block, size, maps, 4 * q + 3), 3);
        }
        store_block(output + PCI_DEFORM_BLOCK * b * stride, stride, sums);
    }
    pci_deform_generic.affine(rows, maps, span.tail, end, output, stride);
}

// sum w R rest of vertex i of a block.
static inline __m128 turn(const char *block, size_t size, const float *normals,
                          const float *rotations, size_t i) {
    const float *n = &normals[3 * i];
    const __m512 sum = turn_columns(block, size, rotations, i, _mm_setr_ps(n[0], n[1], n[2], 0.0F));
    return _mm_add_ps(_mm_add_ps(_mm512_castps512_ps128(sum), _mm512_extractf32x4_ps(sum, 1)),
                      _mm512_extractf32x4_ps(sum, 2));
}

static inline __m512 turn_four(const char *block, size_t size, const float *normals,
                               const float *rotations, size_t i) {
    __m512 n = _mm512_castps128_ps512(turn(block, size, normals, rotations, i));
    n = _mm512_insertf32x4(n, turn(block, size, normals, rotations, i + 1), 1);
    n = _mm512_insertf32x4(n, turn(block, size, normals, rotations, i + 2), 2);
    return _mm512_insertf32x4(n, turn(block, size, normals, rotations, i + 3), 3);
}

// Squared length of each vertex, in all numbers of its lane.
static inline __m512 squares(__m512 n) {
    const __m512 s = _mm512_mul_ps(n, n);
    return _mm512_add_ps(_mm512_add_ps(_mm512_permute_ps(s, 0x00), _mm512_permute_ps(s, 0x55)),
                         _mm512_permute_ps(s, 0xaa));
}

static void normals(const pci_deform_rows *rows, const float *rotations, size_t begin, size_t end,
                    char *output, size_t stride) {
    const pci_deform_span span = pci_deform_whole_blocks(begin, end);
    const size_t size = pci_deform_block_bytes(rows);
    pci_deform_generic.normals(rows, rotations, begin, span.head, output, stride);
    for (size_t b = span.first; b < span.last; ++b) {
        const char *block = rows->blocks + b * size;
        const float *rest = floats(rows->normals + b * PCI_DEFORM_REST);
        __m512 n[4], square = _mm512_setzero_ps();
        for (size_t q = 0; q < 4; ++q) {
            n[q] = turn_four(block, size, rest, rotations, 4 * q);
            // One root and one division for sixteen vertices: four numbers in each lane.
            square = _mm512_mask_mov_ps(square, (__mmask16)(0x1111 << q), squares(n[q]));
        }
        const __m512 scale = _mm512_div_ps(_mm512_set1_ps(1.0F), _mm512_sqrt_ps(square));
        n[0] = _mm512_mul_ps(n[0], _mm512_permute_ps(scale, 0x00));
        n[1] = _mm512_mul_ps(n[1], _mm512_permute_ps(scale, 0x55));
        n[2] = _mm512_mul_ps(n[2], _mm512_permute_ps(scale, 0xaa));
        n[3] = _mm512_mul_ps(n[3], _mm512_permute_ps(scale, 0xff));
        store_block(output + PCI_DEFORM_BLOCK * b * stride, stride, n);
    }
    pci_deform_generic.normals(rows, rotations, span.tail, end, output, stride);
}

const pci_deform_kernel pci_deform_avx512 = {
    .positions = positions, .affine = affine, .normals = normals};
