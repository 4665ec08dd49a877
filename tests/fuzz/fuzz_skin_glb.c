// The reader of foreign weights of `evaluate --motion`, for the square of the corpus as garment and
// proxy.

#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static double positions[] = {0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0.1};
    static uint32_t triangles[] = {0, 1, 2, 0, 2, 3};
    const pc_mesh square = {4, positions, 2, triangles};
    pc_context *context = fuzz_context();
    pc_skin skin = {0};
    if (pc_skin_read_glb(context, fuzz_file(data, size), &square, &square, &skin) == PC_OK) {
        for (size_t i = 0; i < skin.vertex_count * skin.influences; ++i) {
            fuzz_assert(skin.bones[i] < 4 && skin.weights[i] >= 0.0 && skin.weights[i] <= 1.0);
        }
    } else {
        fuzz_assert(skin.bones == NULL && skin.weights == NULL);
    }
    pc_skin_free(context, &skin);
    return 0;
}
