// Stage 8 on any mesh, with pins, a moving attachment and colliders.
#include "soup.h"

static void read_vector(soup_bytes *bytes, double vector[3]) {
    for (size_t k = 0; k < 3; ++k) {
        vector[k] = soup_number(bytes);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    pc_context *context = fuzz_context();
    soup_bytes bytes = {data, size};
    pc_simulate_options options = pc_default_options().simulate;
    options.frames = 2;
    options.frame_steps = 1;
    options.solver_iterations = 2;
    options.dynamics = soup_byte(&bytes) % 2;
    options.substeps = soup_byte(&bytes) % 3;
    options.garment_size = soup_byte(&bytes) % 4;
    const uint8_t parts = soup_byte(&bytes);
    options.self_contact = parts / 32 % 4 / 4.0;
    pc_mesh proxy = soup_any(&bytes);
    pc_wind_key wind = {0};
    pc_pin pin = {.kind = PC_PIN_BOX};
    pc_collider colliders[2] = {{.kind = PC_COLLIDER_SPHERE}, {.kind = PC_COLLIDER_CAPSULE}};
    pc_rigid_key keys[2] = {{.rotation = {0, 0, 0, 1}}, {.time = 0.02}};
    pc_scenario scenario = {
        .winds = &wind,
        .wind_count = parts % 2,
        .pins = &pin,
        .pin_count = parts / 2 % 2,
        .colliders = colliders,
        .collider_count = parts / 4 % 3,
        .attachment = {.kind = parts / 16 % 2 != 0 ? PC_ATTACHMENT_RIGID : PC_ATTACHMENT_NONE,
                       .key_count = 2 * (parts / 16 % 2u),
                       .keys = keys}};
    read_vector(&bytes, wind.velocity);
    read_vector(&bytes, pin.minimum);
    read_vector(&bytes, pin.maximum);
    read_vector(&bytes, keys[1].translation);
    read_vector(&bytes, keys[1].rotation);
    read_vector(&bytes, scenario.attachment.pivot);
    for (size_t i = 0; i < 2; ++i) {
        read_vector(&bytes, colliders[i].from);
        read_vector(&bytes, colliders[i].to);
        colliders[i].radius = 0.25 * soup_number(&bytes);
    }
    const pc_simulate_inputs inputs = {.proxy = &proxy, .scenario = &scenario};
    pc_motion motion = {0};
    const pc_status status = pc_simulate_scenario(context, &inputs, &options, &motion, NULL);
    if (status != PC_ERROR_INVALID_OPTIONS && soup_succeeds(status)) {
        for (size_t i = 0; i < 3 * motion.frame_count * motion.vertex_count; ++i) {
            fuzz_assert(isfinite(motion.positions[i]));
        }
    }
    pc_motion_free(context, &motion);
    soup_free(&proxy);
    return 0;
}
