// Skinning weights as engines take them, and the attributes that hold them.
#include <stdio.h>

#include "io/glb_writer.h"

uint32_t pci_glb_weight_whole(const pci_glb *glb) {
    switch (glb->asset->options.skin.weight_storage) {
    case PC_SKIN_WEIGHTS_U8:
        return UINT8_MAX;
    case PC_SKIN_WEIGHTS_U16:
        return UINT16_MAX;
    default:
        return 0;
    }
}

static uint32_t pack_row(const uint32_t *bones, const double *weights, uint32_t influences,
                         uint32_t *joints, float *packed) {
    uint32_t used = 0;
    for (uint32_t k = 0; k < influences; ++k) {
        const float weight = (float)weights[k];
        if (!(weight > 0.0f)) {
            continue;
        }
        uint32_t at = 0;
        while (at < used && joints[at] != bones[k]) {
            ++at;
        }
        float sum = weight;
        if (at < used) {
            sum += packed[at];
        } else {
            ++used;
        }
        // Moves up to its rank.
        for (; at > 0 && packed[at - 1] < sum; --at) {
            joints[at] = joints[at - 1];
            packed[at] = packed[at - 1];
        }
        joints[at] = bones[k];
        packed[at] = sum;
    }
    double rest = 1.0;
    for (uint32_t k = 1; k < used; ++k) {
        rest -= (double)packed[k];
    }
    packed[0] = (float)rest;
    return used;
}

// Rounds a row of weights with sum 1 to integers with sum `whole`, all within 1 of their share:
// each is rounded down, and the largest remainders get one more, ties to the first. Returns how
// many are above 0; a falling row stays falling.
static uint32_t round_row(uint32_t whole, uint32_t used, double *remainders, uint32_t *joints,
                          float *packed) {
    uint32_t left = whole, kept = 0;
    for (uint32_t k = 0; k < used; ++k) {
        const double share = (double)packed[k] * (double)whole;
        const double low = share < (double)left ? floor(share) : (double)left;
        remainders[k] = share - low;
        packed[k] = (float)low;
        left -= (uint32_t)low;
    }
    for (; left > 0; --left) {
        uint32_t most = 0;
        for (uint32_t k = 1; k < used; ++k) {
            most = remainders[k] > remainders[most] ? k : most;
        }
        packed[most] += 1.0f;
        remainders[most] -= 1.0;
    }
    for (uint32_t k = 0; k < used; ++k) {
        joints[k] = packed[k] > 0.0f ? joints[k] : 0;
        kept += packed[k] > 0.0f;
    }
    return kept;
}

void pci_glb_pack_weights(pci_glb *glb, const pc_skin *skin, pci_glb_weights *result) {
    const uint32_t influences = skin->influences;
    const size_t slots = skin->vertex_count * influences;
    uint32_t *joints = PCI_SCRATCH(&glb->scratch, uint32_t, slots);
    float *weights = PCI_SCRATCH(&glb->scratch, float, slots);
    double *remainders = PCI_SCRATCH(&glb->scratch, double, influences);
    if (joints == NULL || weights == NULL || remainders == NULL) {
        return;
    }
    uint32_t most = 1;
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        const size_t row = v * influences;
        uint32_t used = pack_row(&skin->bones[row], &skin->weights[row], influences, joints + row,
                                 weights + row);
        if (result->whole > 0) {
            used = round_row(result->whole, used, remainders, joints + row, weights + row);
        }
        most = used > most ? used : most;
    }
    // Only as many sets of four as any vertex needs.
    result->slots = (most + 3) / 4 * 4;
    result->joints = PCI_SCRATCH(&glb->scratch, uint32_t, skin->vertex_count * result->slots);
    result->weights = PCI_SCRATCH(&glb->scratch, float, skin->vertex_count * result->slots);
    if (glb->scratch.failed) {
        return;
    }
    for (size_t v = 0; v < skin->vertex_count; ++v) {
        for (uint32_t k = 0; k < influences && k < result->slots; ++k) {
            result->joints[v * result->slots + k] = joints[v * influences + k];
            result->weights[v * result->slots + k] = weights[v * influences + k];
        }
    }
}

static void add_weight_set(pci_glb *glb, cJSON *attributes, const char *name,
                           const pci_glb_weights *packed, uint32_t set, const uint32_t *rows,
                           size_t count) {
    float *floats = NULL;
    uint8_t *bytes = NULL;
    if (packed->whole == 0) {
        floats = pci_glb_add_attribute(glb, attributes, name, count, 4);
    } else {
        const bool narrow = packed->whole == UINT8_MAX;
        bytes = pci_glb_add_view(glb, count * (narrow ? 4 : 8), GL_ARRAY_BUFFER);
        cJSON *accessor = pci_glb_add_accessor(
            glb, 0, narrow ? GL_UNSIGNED_BYTE : GL_UNSIGNED_SHORT, count, "VEC4");
        pci_json_bool(&glb->json, accessor, "normalized", true);
        pci_json_count(&glb->json, attributes, name, glb->accessor_count - 1);
    }
    for (size_t i = 0; i < 4 * count && (floats != NULL || bytes != NULL); ++i) {
        const size_t v = rows != NULL ? rows[i / 4] : i / 4;
        const float weight = packed->weights[v * packed->slots + 4 * set + i % 4];
        if (floats != NULL) {
            floats[i] = weight;
        } else if (packed->whole == UINT8_MAX) {
            bytes[i] = (uint8_t)weight;
        } else {
            ((uint16_t *)(void *)bytes)[i] = (uint16_t)weight;
        }
    }
}

void pci_glb_add_weights(pci_glb *glb, cJSON *attributes, const pci_glb_weights *packed,
                         const uint32_t *rows, size_t count) {
    const bool narrow = pci_glb_joint_count(glb) <= 256;
    for (uint32_t set = 0; set < packed->slots / 4; ++set) {
        char name[32];
        unsigned char *joints = pci_glb_add_view(glb, count * (narrow ? 4 : 8), GL_ARRAY_BUFFER);
        if (joints == NULL) {
            return;
        }
        for (size_t i = 0; i < 4 * count; ++i) {
            const size_t v = rows != NULL ? rows[i / 4] : i / 4;
            const uint32_t joint = packed->joints[v * packed->slots + 4 * set + i % 4];
            if (narrow) {
                joints[i] = (uint8_t)joint;
            } else {
                ((uint16_t *)(void *)joints)[i] = (uint16_t)joint;
            }
        }
        pci_glb_add_accessor(glb, 0, narrow ? GL_UNSIGNED_BYTE : GL_UNSIGNED_SHORT, count, "VEC4");
        snprintf(name, sizeof(name), "JOINTS_%u", set);
        pci_json_count(&glb->json, attributes, name, glb->accessor_count - 1);

        snprintf(name, sizeof(name), "WEIGHTS_%u", set);
        add_weight_set(glb, attributes, name, packed, set, rows, count);
    }
}
