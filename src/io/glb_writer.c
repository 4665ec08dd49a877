// The buffer of a binary glTF file, its views and accessors.
#include "io/glb_writer.h"

void *pci_glb_add_view(pci_glb *glb, size_t size, int target) {
    const size_t offset = (glb->size + 3) & ~(size_t)3;
    void *bytes = glb->bytes;
    if (!pci_scratch_reserve(&glb->scratch, &bytes, &glb->capacity, offset + size, 1)) {
        return NULL;
    }
    glb->bytes = bytes;
    glb->size = offset + size;
    cJSON *view = pci_json_object(&glb->json, glb->views, NULL);
    pci_json_count(&glb->json, view, "buffer", 0);
    pci_json_count(&glb->json, view, "byteOffset", offset);
    pci_json_count(&glb->json, view, "byteLength", size);
    if (target != 0) {
        pci_json_count(&glb->json, view, "target", (uint64_t)target);
    }
    ++glb->view_count;
    return glb->bytes + offset;
}

cJSON *pci_glb_add_accessor(pci_glb *glb, size_t offset, int component, size_t count,
                            const char *type) {
    cJSON *accessor = pci_json_object(&glb->json, glb->accessors, NULL);
    pci_json_count(&glb->json, accessor, "bufferView", glb->view_count - 1);
    if (offset != 0) {
        pci_json_count(&glb->json, accessor, "byteOffset", offset);
    }
    pci_json_count(&glb->json, accessor, "componentType", (uint64_t)component);
    pci_json_count(&glb->json, accessor, "count", count);
    pci_json_string(&glb->json, accessor, "type", type);
    ++glb->accessor_count;
    return accessor;
}

float *pci_glb_add_floats(pci_glb *glb, size_t count, uint32_t tuple, int target,
                          cJSON **accessor) {
    static const char *const types[17] = {
        [1] = "SCALAR", [2] = "VEC2", [3] = "VEC3", [4] = "VEC4", [16] = "MAT4"};
    float *values = pci_glb_add_view(glb, count * tuple * sizeof(float), target);
    if (values == NULL) {
        return NULL;
    }
    *accessor = pci_glb_add_accessor(glb, 0, GL_FLOAT, count, types[tuple]);
    return values;
}

float *pci_glb_add_attribute(pci_glb *glb, cJSON *attributes, const char *name, size_t count,
                             uint32_t tuple) {
    cJSON *accessor = NULL;
    float *values = pci_glb_add_floats(glb, count, tuple, GL_ARRAY_BUFFER, &accessor);
    pci_json_count(&glb->json, attributes, name, glb->accessor_count - 1);
    return values;
}

void pci_glb_add_limits(pci_glb *glb, cJSON *accessor, const float *values, size_t count,
                        size_t tuple) {
    cJSON *minimum = pci_json_array(&glb->json, accessor, "min");
    cJSON *maximum = pci_json_array(&glb->json, accessor, "max");
    for (size_t k = 0; k < tuple; ++k) {
        float low = values[k], high = values[k];
        for (size_t i = 1; i < count; ++i) {
            const float value = values[i * tuple + k];
            low = value < low ? value : low;
            high = value > high ? value : high;
        }
        pci_json_number(&glb->json, minimum, NULL, (double)low);
        pci_json_number(&glb->json, maximum, NULL, (double)high);
    }
}
