// Stage 9, its baselines and the measures of weights, on any garment, proxy and motion.
#include "soup.h"

enum { SKIN_FRAMES = 3 };

static void measure(pc_context *context, const pc_mesh *surface, const pc_mesh *proxy,
                    const pc_motion *motion, pc_skin *skin) {
    pc_skin_losses losses;
    pc_motion_measures measures;
    (void)soup_succeeds(pc_skin_evaluate(context, surface, proxy, motion, skin, NULL, &losses));
    (void)soup_succeeds(pc_evaluate_motion(context, surface, proxy, motion, skin, NULL, &measures));
    pc_skin_free(context, skin);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    const uint8_t method = soup_byte(&bytes) % 5;
    pc_skin_options options = pc_default_options().skin;
    options.solver = method % 2;
    options.influences = 1 + soup_byte(&bytes) % 6;
    options.rounds = options.epochs = 1 + soup_byte(&bytes) % 3;
    pc_mesh surface = soup_any(&bytes), proxy = soup_any(&bytes);
    pc_motion motion = {.frame_count = 1 + soup_byte(&bytes) % SKIN_FRAMES,
                        .vertex_count = proxy.vertex_count,
                        .frame_time = 0.05};
    motion.positions = soup_allocate(3 * motion.frame_count * motion.vertex_count * sizeof(double));
    motion.pinned = soup_allocate(motion.vertex_count);
    for (size_t v = 0; v < motion.vertex_count; ++v) {
        motion.pinned[v] = soup_byte(&bytes) % 2;
    }
    for (size_t i = 0; i < 3 * motion.frame_count * motion.vertex_count; ++i) {
        motion.positions[i] = soup_number(&bytes);
    }
    pc_skin skin = {0};
    const uint32_t k = options.influences;
    const pc_status status =
        method < 2    ? pc_skin_optimize(context, &surface, &proxy, &motion, &options, &skin, NULL)
        : method == 2 ? pc_skin_closest_triangle(context, &surface, &proxy, &skin)
        : method == 3 ? pc_skin_inverse_distance(context, &surface, &proxy, k, &skin)
                      : pc_skin_heat_smoothed(context, &surface, &proxy, k, &skin);
    if (soup_succeeds(status)) {
        soup_check_skin(&skin, proxy.vertex_count);
        const size_t last = skin.vertex_count * skin.influences - 1;
        skin.bones[last] = soup_byte(&bytes) % 4 == 3 ? UINT32_MAX : skin.bones[last];
        skin.weights[last] = soup_byte(&bytes) % 4 == 3 ? soup_number(&bytes) : skin.weights[last];
        measure(context, &surface, &proxy, &motion, &skin);
    }
    free(motion.positions);
    free(motion.pinned);
    soup_free(&surface);
    soup_free(&proxy);
    return 0;
}
