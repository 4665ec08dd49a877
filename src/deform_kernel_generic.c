// Plain code: four floats per register, which every processor that we know has. Also the reference
// for the other kernels and what they use for vertices outside whole blocks.
#include <math.h>
#include <string.h>

#include "deform_kernel.h"

typedef float four __attribute__((vector_size(16), aligned(4), may_alias));

static inline four load(const float *p) { return *(const four *)(const void *)p; }

static inline void store(char *output, four value) {
    const float xyz[3] = {value[0], value[1], value[2]};
    memcpy(output, xyz, sizeof(xyz));
}

// Weights and joints of the first set of a vertex.
typedef struct row {
    const float *weights;
    const uint16_t *joints;
} row;

static inline row row_of(const pci_deform_rows *rows, size_t v, size_t set) {
    const char *at = rows->blocks + v / PCI_DEFORM_BLOCK * pci_deform_block_bytes(rows) +
                     PCI_DEFORM_REST + set * PCI_DEFORM_SET_BYTES;
    const size_t slot = v % PCI_DEFORM_BLOCK * PCI_DEFORM_SET;
    return (row){(const float *)(const void *)at + slot,
                 (const uint16_t *)(const void *)(at + PCI_DEFORM_WEIGHTS) + slot};
}

static void positions(const pci_deform_rows *rows, const float *displacements, size_t begin,
                      size_t end, char *output, size_t stride) {
    for (size_t v = begin; v < end; ++v) {
        const char *block = rows->blocks + v / PCI_DEFORM_BLOCK * pci_deform_block_bytes(rows);
        // The fourth number is not used: of the next vertex, or the first weight.
        four sum = load((const float *)(const void *)block + 3 * (v % PCI_DEFORM_BLOCK));
        for (size_t set = 0; set < rows->set_count; ++set) {
            const row r = row_of(rows, v, set);
            sum += r.weights[0] * load(&displacements[4 * (size_t)r.joints[0]]);
            sum += r.weights[1] * load(&displacements[4 * (size_t)r.joints[1]]);
            sum += r.weights[2] * load(&displacements[4 * (size_t)r.joints[2]]);
            sum += r.weights[3] * load(&displacements[4 * (size_t)r.joints[3]]);
        }
        store(output + v * stride, sum);
    }
}

static void affine(const pci_deform_rows *rows, const float *maps, size_t begin, size_t end,
                   char *output, size_t stride) {
    for (size_t v = begin; v < end; ++v) {
        const char *block = rows->blocks + v / PCI_DEFORM_BLOCK * pci_deform_block_bytes(rows);
        const float *p = (const float *)(const void *)block + 3 * (v % PCI_DEFORM_BLOCK);
        four x = {0.0F}, y = {0.0F}, z = {0.0F}, t = {0.0F};
        for (size_t set = 0; set < rows->set_count; ++set) {
            const row r = row_of(rows, v, set);
            for (size_t k = 0; k < PCI_DEFORM_SET; ++k) {
                const float *columns = &maps[16 * (size_t)r.joints[k]];
                x += r.weights[k] * load(columns);
                y += r.weights[k] * load(columns + 4);
                z += r.weights[k] * load(columns + 8);
                t += r.weights[k] * load(columns + 12);
            }
        }
        store(output + v * stride, (p[0] * x + p[1] * y) + (p[2] * z + t));
    }
}

static void normals(const pci_deform_rows *rows, const float *rotations, size_t begin, size_t end,
                    char *output, size_t stride) {
    for (size_t v = begin; v < end; ++v) {
        four x = {0.0F}, y = {0.0F}, z = {0.0F};
        for (size_t set = 0; set < rows->set_count; ++set) {
            const row r = row_of(rows, v, set);
            for (size_t k = 0; k < PCI_DEFORM_SET; ++k) {
                const float *columns = &rotations[16 * (size_t)r.joints[k]];
                x += r.weights[k] * load(columns);
                y += r.weights[k] * load(columns + 4);
                z += r.weights[k] * load(columns + 8);
            }
        }
        const float *n = (const float *)(const void *)rows->normals + 3 * v;
        const four turned = (n[0] * x + n[1] * y) + n[2] * z;
        const four square = turned * turned;
        store(output + v * stride, turned * (1.0F / sqrtf((square[0] + square[1]) + square[2])));
    }
}

const pci_deform_kernel pci_deform_generic = {
    .positions = positions, .affine = affine, .normals = normals};
