// Which vertices of the proxy are held.
#include <stdlib.h>

#include "core/union_find.h"
#include "geometry/bvh.h"
#include "geometry/topology.h"
#include "stages/simulate/simulate_internal.h"

static const char stage[] = "simulate";

bool pci_matches(const char *pattern, const char *text) {
    // On a mismatch the last * takes one more byte.
    const char *star = NULL, *retry = NULL;
    while (*text != '\0') {
        if (*pattern == '*') {
            star = pattern++;
            retry = text;
        } else if (*pattern == '?' || *pattern == *text) {
            ++pattern;
            ++text;
        } else if (star != NULL) {
            pattern = star + 1;
            text = ++retry;
        } else {
            return false;
        }
    }
    while (*pattern == '*') {
        ++pattern;
    }
    return *pattern == '\0';
}

// ---- heights -----------------------------------------------------------------------------------

typedef struct height {
    double value;
    uint32_t vertex;
} height;

static int compare_heights(const void *a, const void *b) {
    const height *x = a, *y = b;
    if (x->value != y->value) {
        return x->value > y->value ? -1 : 1;
    }
    return x->vertex < y->vertex ? -1 : x->vertex > y->vertex;
}

static height *sort_by_height(pci_scratch *scratch, const pc_mesh *mesh, size_t axis) {
    height *heights = PCI_SCRATCH(scratch, height, mesh->vertex_count);
    if (heights != NULL) {
        for (size_t v = 0; v < mesh->vertex_count; ++v) {
            heights[v].value = mesh->positions[3 * v + axis];
            heights[v].vertex = (uint32_t)v;
        }
        qsort(heights, mesh->vertex_count, sizeof(*heights), compare_heights);
    }
    return heights;
}

// 1e-9: the product may lie just above a whole number.
static size_t pin_count(double fraction, size_t vertex_count) {
    const double wanted = ceil(fraction * (double)vertex_count - 1e-9);
    return wanted > 0.0 ? (size_t)wanted : 0;
}

// Holds the highest ceil(fraction * #part) vertices of every connected part that has no held one:
// it would fall for ever.
static bool pin_loose_parts(pci_scratch *scratch, const pc_mesh *mesh, const height *heights,
                            double fraction, uint8_t *pinned) {
    const size_t nv = mesh->vertex_count;
    uint32_t *parts = PCI_SCRATCH(scratch, uint32_t, nv);
    size_t *sizes = PCI_SCRATCH(scratch, size_t, nv);   // of the part that starts at v
    size_t *missing = PCI_SCRATCH(scratch, size_t, nv); // vertices of it that must still be held
    if (scratch->failed) {
        return false;
    }
    (void)pci_vertex_components(mesh, parts);
    for (size_t v = 0; v < nv; ++v) {
        ++sizes[pci_find_root(parts, (uint32_t)v)];
    }
    for (size_t v = 0; v < nv; ++v) {
        missing[v] = pin_count(fraction, sizes[v]);
    }
    for (size_t v = 0; v < nv; ++v) {
        if (pinned[v]) {
            missing[pci_find_root(parts, (uint32_t)v)] = 0;
        }
    }
    for (size_t i = 0; i < nv; ++i) {
        size_t *left = &missing[pci_find_root(parts, heights[i].vertex)];
        if (*left > 0) {
            --*left;
            pinned[heights[i].vertex] = 1;
        }
    }
    return true;
}

// ---- rules -------------------------------------------------------------------------------------

// The triangles of the visual mesh whose part or material has a matching name; `found` tells
// whether there is such a name at all.
static bool mark_named(pci_scratch *scratch, const pc_visual *visual, const pc_pin *pin,
                       uint8_t *marked, bool *found) {
    const bool mesh = pin->kind == PC_PIN_MESH;
    const size_t count = mesh ? visual->part_count : visual->material_count;
    const uint32_t *owners = mesh ? visual->triangle_parts : visual->triangle_materials;
    uint8_t *matches = PCI_SCRATCH(scratch, uint8_t, count);
    if (matches == NULL) {
        return false;
    }
    *found = false;
    for (size_t i = 0; i < count && owners != NULL; ++i) {
        const char *name = mesh ? &visual->part_names[PC_NAME_SIZE * i] : visual->materials[i].name;
        matches[i] = pci_matches(pin->name, name);
        *found = *found || matches[i] != 0;
    }
    for (size_t t = 0; t < visual->surface.triangle_count && *found; ++t) {
        marked[t] = matches[owners[t]];
    }
    return true;
}

// The attribute at a point of the visual mesh.
static double attribute_at(const pc_visual *visual, pc_attribute attribute,
                           const pci_closest *closest) {
    const bool texture = attribute >= PC_ATTRIBUTE_U;
    const float *values = texture ? visual->texcoords : visual->colors;
    const size_t stride = texture ? 2 : 4;
    const size_t channel = (size_t)attribute - (texture ? PC_ATTRIBUTE_U : 0);
    double sum = 0.0;
    for (size_t c = 0; c < 3; ++c) {
        const size_t corner = visual->corner_triangles[3 * (size_t)closest->triangle + c];
        sum += closest->barycentric[c] * (double)values[stride * corner + channel];
    }
    return sum;
}

static pc_status check_rule(pc_context *context, const pc_visual *visual, const pc_pin *pin,
                            size_t index) {
    if (pin->kind == PC_PIN_HIGHEST || pin->kind == PC_PIN_BOX) {
        return PC_OK;
    }
    const char *lacking = visual == NULL                  ? "a visual mesh"
                          : pin->kind != PC_PIN_ATTRIBUTE ? NULL
                          : pin->attribute < PC_ATTRIBUTE_U
                              ? (visual->colors == NULL ? "vertex colours" : NULL)
                          : visual->texcoords == NULL ? "texture coordinates"
                                                      : NULL;
    return lacking == NULL
               ? PC_OK
               : pci_fail(context, PC_ERROR_INVALID_OPTIONS, stage,
                          "simulate: pins[%zu] needs %s, which the input lacks", index, lacking);
}

// Marks the vertices that a rule names by the visual mesh.
static pc_status pin_by_visual(pci_scratch *scratch, const pc_simulate_inputs *inputs,
                               const pc_pin *pin, size_t index, const pci_closest *closest,
                               uint8_t *chosen) {
    const pc_visual *visual = inputs->visual;
    uint8_t *marked = PCI_SCRATCH(scratch, uint8_t, visual->surface.triangle_count);
    bool found = true;
    if (marked == NULL ||
        (pin->kind != PC_PIN_ATTRIBUTE && !mark_named(scratch, visual, pin, marked, &found))) {
        return pci_fail_memory(scratch->context, stage);
    }
    if (!found) {
        return pci_fail(scratch->context, PC_ERROR_INVALID_OPTIONS, stage,
                        "simulate: pins[%zu]: no %s of the garment is called \"%s\"", index,
                        pin->kind == PC_PIN_MESH ? "mesh" : "material", pin->name);
    }
    for (size_t v = 0; v < inputs->proxy->vertex_count; ++v) {
        chosen[v] = pin->kind == PC_PIN_ATTRIBUTE
                        ? attribute_at(visual, pin->attribute, &closest[v]) > pin->above
                        : marked[closest[v].triangle];
    }
    return PC_OK;
}

static bool inside_box(const pc_pin *pin, const double *point) {
    for (size_t k = 0; k < 3; ++k) {
        if (!(point[k] >= pin->minimum[k] && point[k] <= pin->maximum[k])) {
            return false;
        }
    }
    return true;
}

// The nearest point of the visual mesh to each vertex of the proxy.
static pc_status find_closest(pci_scratch *scratch, const pc_simulate_inputs *inputs,
                              pci_closest **closest) {
    pci_bvh *bvh = NULL;
    *closest = PCI_SCRATCH(scratch, pci_closest, inputs->proxy->vertex_count);
    if (*closest == NULL) {
        return pci_fail_memory(scratch->context, stage);
    }
    const pc_status status =
        pci_bvh_create(scratch->context, stage, &inputs->visual->surface, &bvh);
    for (size_t v = 0; v < inputs->proxy->vertex_count && status == PC_OK; ++v) {
        (*closest)[v] = pci_bvh_closest(bvh, &inputs->proxy->positions[3 * v], INFINITY);
    }
    pci_bvh_destroy(scratch->context, bvh);
    return status;
}

static pc_status apply_rules(pci_scratch *scratch, const pc_simulate_inputs *inputs,
                             const height *heights, uint8_t *pinned, uint64_t *unmatched) {
    const size_t nv = inputs->proxy->vertex_count;
    pci_closest *closest = NULL;
    uint8_t *chosen = PCI_SCRATCH(scratch, uint8_t, nv);
    pc_status status = chosen != NULL ? PC_OK : pci_fail_memory(scratch->context, stage);
    for (size_t i = 0; i < inputs->scenario->pin_count && status == PC_OK; ++i) {
        const pc_pin *pin = &inputs->scenario->pins[i];
        status = check_rule(scratch->context, inputs->visual, pin, i);
        if (status != PC_OK) {
            break;
        }
        memset(chosen, 0, nv);
        if (pin->kind == PC_PIN_HIGHEST) {
            for (size_t k = 0; k < pin_count(pin->fraction, nv); ++k) {
                chosen[heights[k].vertex] = 1;
            }
        } else if (pin->kind == PC_PIN_BOX) {
            for (size_t v = 0; v < nv; ++v) {
                chosen[v] = inside_box(pin, &inputs->proxy->positions[3 * v]);
            }
        } else {
            status = closest == NULL ? find_closest(scratch, inputs, &closest) : PC_OK;
            if (status == PC_OK) {
                status = pin_by_visual(scratch, inputs, pin, i, closest, chosen);
            }
        }
        bool any = false;
        for (size_t v = 0; v < nv; ++v) {
            any = any || chosen[v] != 0;
            pinned[v] |= chosen[v];
        }
        *unmatched += !any;
    }
    return status;
}

pc_status pci_pin_vertices(pci_scratch *scratch, const pc_simulate_inputs *inputs, double fraction,
                           size_t axis, uint8_t *pinned, uint64_t *unmatched) {
    const pc_mesh *proxy = inputs->proxy;
    const height *heights = sort_by_height(scratch, proxy, axis);
    pc_status status = heights != NULL ? PC_OK : pci_fail_memory(scratch->context, stage);
    if (status == PC_OK && inputs->scenario->pin_count != 0) {
        status = apply_rules(scratch, inputs, heights, pinned, unmatched);
    } else if (status == PC_OK) {
        for (size_t i = 0; i < pin_count(fraction, proxy->vertex_count); ++i) {
            pinned[heights[i].vertex] = 1;
        }
    }
    if (status == PC_OK && !pin_loose_parts(scratch, proxy, heights, fraction, pinned)) {
        status = pci_fail_memory(scratch->context, stage);
    }
    return status;
}
