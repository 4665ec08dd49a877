// What crosses the border of the import child: the buffer that it sends (first byte even; with
// magic number and size put right in every other case), and the rewriting of OBJ files (one of
// four), GLB and glTF files (one of eight) inside it.
#include <string.h>

#include "../../cli/scene.h"
#include "fuzz.h"

// What is written must be read again.
static void rewrite(const uint8_t *data, size_t size, scene_format format) {
    char message[200];
    size_t once = size, twice;
    char *bytes = malloc(size + 1); // of its own, so that reading beyond it is noticed
    fuzz_assert(bytes != NULL);
    memcpy(bytes, data, size);
    char *plain =
        scene_plain_gltf("/nowhere/fuzz.gltf", bytes, &once, format, message, sizeof(message));
    fuzz_assert((plain == NULL) == (message[0] != '\0'));
    if (plain != NULL) {
        twice = once;
        char *again = scene_plain_gltf("/nowhere/fuzz.gltf", plain, &twice, SCENE_GLB, message,
                                       sizeof(message));
        fuzz_assert(again != NULL);
        free(again);
    }
    free(plain);
    free(bytes);
}

// What is written must be read again, as it is.
static void respell(const uint8_t *data, size_t size) {
    char message[64];
    size_t once = size, twice;
    char *bytes = malloc(size + 1); // of its own, so that reading beyond it is noticed
    fuzz_assert(bytes != NULL);
    memcpy(bytes, data, size);
    char *plain = scene_plain_obj("/nowhere/fuzz.obj", bytes, &once, message, sizeof(message));
    fuzz_assert((plain == NULL) == (message[0] != '\0'));
    if (plain != NULL) {
        twice = once;
        char *again = scene_plain_obj("/nowhere/fuzz.obj", plain, &twice, message, sizeof(message));
        fuzz_assert(again != NULL && twice == once && memcmp(again, plain, once) == 0);
        free(again);
    }
    free(plain);
    free(bytes);
}

static void measure(const uint8_t *data, size_t size) {
    char message[64];
    char *bytes = malloc(size + 1);
    fuzz_assert(bytes != NULL);
    memcpy(bytes, data, size);
    fuzz_assert(scene_check_ply(bytes, size, message, sizeof(message)) == (message[0] == '\0'));
    size_t left = size;
    fuzz_assert(scene_check_stl(bytes, &left, message, sizeof(message)) == (message[0] == '\0'));
    fuzz_assert(left <= size);
    free(bytes);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size == 0) {
        return 0;
    }
    if (data[0] % 2 != 0) {
        if (data[0] % 8 == 1) {
            rewrite(data + 1, size - 1, data[0] % 16 == 1 ? SCENE_GLB : SCENE_GLTF);
        } else {
            (data[0] % 4 == 3 ? respell : measure)(data + 1, size - 1);
        }
        return 0;
    }
    pc_context *context = fuzz_context();
    char *buffer = malloc(size);
    scene_data scene;
    fuzz_assert(buffer != NULL);
    memcpy(buffer, data + 1, size - 1);
    if (data[0] % 4 == 2 && size - 1 >= sizeof(scene.header)) {
        scene_header header;
        memcpy(&header, buffer, sizeof(header));
        memcpy(header.magic, SCENE_MAGIC, sizeof(header.magic));
        header.size = size - 1;
        memcpy(buffer, &header, sizeof(header));
    }
    if (scene_open(buffer, size - 1, &scene) == NULL) {
        uint8_t *chosen = calloc(scene.header.part_count + 1, 1);
        char names[256];
        pc_visual visual = {0};
        pc_character character = {0};
        fuzz_assert(chosen != NULL);
        (void)scene_select(&scene, NULL, 0, chosen);
        scene_names(&scene, names, sizeof(names));
        if (scene_visual(&scene, chosen, context, &visual, NULL) == PC_OK) {
            memset(chosen, 0, scene.header.part_count);
            (void)scene_character(&scene, chosen, context, &character);
        }
        pc_character_free(context, &character);
        pc_visual_free(context, &visual);
        free(chosen);
    }
    scene_free(&scene);
    return 0;
}
