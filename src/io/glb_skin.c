// Skinning weights out of a binary glTF file. The file may come from anywhere: every index, count
// and offset is checked before it is used.
#include <errno.h>
#include <stdarg.h>
#include <stdio.h>

#include "geometry/knn.h"
#include "geometry/topology.h"
#include "io/json.h"
#include "proxycloth/evaluate_motion.h"

#define STAGE            "weights"
#define LARGEST_FILE     ((size_t)1 << 31)
#define VERTEX_REACH     1e-4 // of the diagonal
#define JOINT_REACH      1e-3
#define LARGEST_COUNT    ((size_t)1 << 28)
#define LARGEST_VERTICES ((size_t)1 << 24)

enum { LARGEST_SETS = 8, INFLUENCES_MAX = 4 * LARGEST_SETS };

typedef struct reader {
    pc_context *context;
    const char *path;
    pci_scratch scratch;
    cJSON *json;
    const unsigned char *bin;
    size_t bin_size;
    const pc_mesh *surface, *proxy;
    double diagonal;
    // Vertices of all skinned primitives so far.
    size_t count, position_capacity, bone_capacity, weight_capacity;
    double *positions; // #count by 3
    uint32_t *bones;   // #count by INFLUENCES_MAX, proxy vertices
    double *weights;   // #count by INFLUENCES_MAX
} reader;

__attribute__((format(printf, 2, 3))) static pc_status fail(const reader *r, const char *format,
                                                            ...) {
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof(text), format, arguments);
    va_end(arguments);
    return pci_fail(r->context, PC_ERROR_FORMAT, STAGE, "%s: %s", r->path, text);
}

// ---- container ----------------------------------------------------------------------------------

static size_t u32_at(const unsigned char *at) {
    return at[0] | (size_t)at[1] << 8 | (size_t)at[2] << 16 | (size_t)at[3] << 24;
}

static pc_status read_bytes(reader *r, unsigned char **bytes, size_t *size) {
    FILE *file = fopen(r->path, "rb");
    if (file == NULL) {
        return pci_fail(r->context, PC_ERROR_IO, STAGE, "%s: %s", r->path, strerror(errno));
    }
    pc_status status = PC_OK;
    size_t capacity = 0;
    for (;;) {
        void *grown = *bytes;
        if (*size >= LARGEST_FILE) {
            status = fail(r, "the file has more than 2 GiB");
            break;
        }
        if (!pci_scratch_reserve(&r->scratch, &grown, &capacity, *size + 65536, 1)) {
            status = pci_fail_memory(r->context, STAGE);
            break;
        }
        *bytes = grown;
        const size_t got = fread(*bytes + *size, 1, capacity - *size, file);
        *size += got;
        if (got == 0) {
            if (ferror(file)) {
                status = pci_fail(r->context, PC_ERROR_IO, STAGE, "%s: the file cannot be read",
                                  r->path);
            }
            break;
        }
    }
    fclose(file);
    return status;
}

static pc_status open_container(reader *r) {
    unsigned char *bytes = NULL;
    size_t size = 0;
    const pc_status status = read_bytes(r, &bytes, &size);
    if (status != PC_OK) {
        return status;
    }
    if (size < 20 || memcmp(bytes, "glTF", 4) != 0 || u32_at(bytes + 4) != 2 ||
        memcmp(bytes + 16, "JSON", 4) != 0) {
        return fail(r, "this is no binary glTF 2.0 file");
    }
    const size_t json_size = u32_at(bytes + 12);
    if (json_size > size - 20) {
        return fail(r, "the file is truncated");
    }
    const size_t rest = 20 + json_size;
    if (size - rest >= 8 && memcmp(bytes + rest + 4, "BIN", 4) == 0) {
        r->bin = bytes + rest + 8;
        r->bin_size = u32_at(bytes + rest);
        if (r->bin_size > size - rest - 8) {
            return fail(r, "the file is truncated");
        }
    }
    r->json = cJSON_ParseWithLength((const char *)bytes + 20, json_size);
    return r->json != NULL ? PC_OK : fail(r, "its JSON is damaged");
}

// ---- accessors ----------------------------------------------------------------------------------

// A number of an object that is a count or an index; `missing` where there is none.
static size_t get_count(const cJSON *object, const char *name, size_t missing) {
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(object, name);
    if (item == NULL) {
        return missing;
    }
    const double value = cJSON_IsNumber(item) ? item->valuedouble : -1.0;
    return value >= 0.0 && value <= 4294967295.0 ? (size_t)value : SIZE_MAX;
}

static const cJSON *get_element(const cJSON *parent, const char *list, size_t index) {
    const cJSON *array = cJSON_GetObjectItemCaseSensitive(parent, list);
    return cJSON_IsArray(array) && index < LARGEST_COUNT ? cJSON_GetArrayItem(array, (int)index)
                                                         : NULL;
}

typedef struct accessor {
    const unsigned char *start;
    size_t count, stride, type;
    bool normalized;
} accessor;

static pc_status open_accessor(const reader *r, size_t index, const char *type, size_t width,
                               accessor *a) {
    const cJSON *object = get_element(r->json, "accessors", index);
    const cJSON *kind = cJSON_GetObjectItemCaseSensitive(object, "type");
    const cJSON *view =
        get_element(r->json, "bufferViews", get_count(object, "bufferView", SIZE_MAX));
    if (object == NULL || view == NULL || !cJSON_IsString(kind) ||
        strcmp(kind->valuestring, type) != 0 || cJSON_HasObjectItem(object, "sparse") ||
        cJSON_HasObjectItem(view, "extensions")) {
        return fail(r, "accessor %zu is not %s, sparse, compressed or missing", index, type);
    }
    a->type = get_count(object, "componentType", 0);
    a->count = get_count(object, "count", SIZE_MAX);
    a->normalized = cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(object, "normalized"));
    const size_t size = a->type == 5126 || a->type == 5125 ? 4
                        : a->type == 5123                  ? 2
                        : a->type == 5121                  ? 1
                                                           : 0;
    a->stride = get_count(view, "byteStride", size * width);
    const size_t view_start = get_count(view, "byteOffset", 0);
    const size_t view_size = get_count(view, "byteLength", SIZE_MAX);
    const size_t offset = get_count(object, "byteOffset", 0);
    if (size == 0 || a->count == 0 || a->count > LARGEST_COUNT ||
        get_count(view, "buffer", 0) != 0 || a->stride < size * width ||
        a->stride > 255 + size * width || view_start > r->bin_size ||
        view_size > r->bin_size - view_start || offset > view_size ||
        (a->count - 1) * a->stride + size * width > view_size - offset) {
        return fail(r, "accessor %zu leaves the file's binary chunk", index);
    }
    a->start = r->bin + view_start + offset;
    return PC_OK;
}

static double accessor_at(const accessor *a, size_t element, size_t k) {
    const unsigned char *start = a->start + element * a->stride;
    float real;
    switch (a->type) {
    case 5126:
        memcpy(&real, start + 4 * k, sizeof(real));
        return (double)real;
    case 5125:
        return (double)u32_at(start + 4 * k);
    case 5123:
        return (double)(start[2 * k] | start[2 * k + 1] << 8) / (a->normalized ? 65535.0 : 1.0);
    default:
        return (double)start[k] / (a->normalized ? 255.0 : 1.0);
    }
}

// ---- joints -------------------------------------------------------------------------------------

// Where the inverse of an affine matrix (column by column) takes the origin. False: no inverse.
static bool rest_of(const double m[16], double rest[3]) {
    double yz[3], zx[3], xy[3];
    pci_cross(&m[4], &m[8], yz);
    pci_cross(&m[8], &m[0], zx);
    pci_cross(&m[0], &m[4], xy);
    const double det = pci_dot(&m[0], yz);
    rest[0] = -pci_dot(yz, &m[12]) / det;
    rest[1] = -pci_dot(zx, &m[12]) / det;
    rest[2] = -pci_dot(xy, &m[12]) / det;
    return isfinite(rest[0]) && isfinite(rest[1]) && isfinite(rest[2]);
}

// The proxy vertex of each joint of a skin; PC_INVALID_INDEX where there is none near.
static pc_status match_joints(reader *r, const pci_knn *proxy, const cJSON *skin,
                              uint32_t **vertices, size_t *count) {
    const cJSON *joints = cJSON_GetObjectItemCaseSensitive(skin, "joints");
    accessor matrices = {0};
    const pc_status status =
        open_accessor(r, get_count(skin, "inverseBindMatrices", SIZE_MAX), "MAT4", 16, &matrices);
    if (status != PC_OK) {
        return status;
    }
    *count = cJSON_IsArray(joints) ? (size_t)cJSON_GetArraySize(joints) : 0;
    if (*count == 0 || matrices.count < *count || matrices.type != 5126) {
        return fail(r, "a skin has %zu joints and %zu inverse bind matrices", *count,
                    matrices.count);
    }
    *vertices = PCI_SCRATCH(&r->scratch, uint32_t, *count);
    if (*vertices == NULL) {
        return pci_fail_memory(r->context, STAGE);
    }
    const double reach = JOINT_REACH * r->diagonal;
    for (size_t j = 0; j < *count; ++j) {
        double m[16], rest[3], squared = INFINITY;
        for (size_t k = 0; k < 16; ++k) {
            m[k] = accessor_at(&matrices, j, k);
        }
        uint32_t nearest = PC_INVALID_INDEX;
        if (rest_of(m, rest)) {
            pci_knn_query(proxy, rest, 1, PC_INVALID_INDEX, &nearest, &squared);
        }
        (*vertices)[j] = squared <= reach * reach ? nearest : PC_INVALID_INDEX;
    }
    return PC_OK;
}

// ---- primitives ---------------------------------------------------------------------------------

typedef struct influence_sets {
    size_t count;
    accessor joints[LARGEST_SETS], weights[LARGEST_SETS];
} influence_sets;

static pc_status open_sets(const reader *r, const cJSON *attributes, size_t vertex_count,
                           influence_sets *sets) {
    pc_status status = PC_OK;
    for (sets->count = 0; sets->count < LARGEST_SETS && status == PC_OK; ++sets->count) {
        char joints[16], weights[16];
        const unsigned set = (unsigned)sets->count;
        snprintf(joints, sizeof(joints), "JOINTS_%u", set);
        snprintf(weights, sizeof(weights), "WEIGHTS_%u", set);
        if (!cJSON_HasObjectItem(attributes, joints)) {
            break;
        }
        accessor *j = &sets->joints[set], *w = &sets->weights[set];
        status = open_accessor(r, get_count(attributes, joints, SIZE_MAX), "VEC4", 4, j);
        if (status == PC_OK) {
            status = open_accessor(r, get_count(attributes, weights, SIZE_MAX), "VEC4", 4, w);
        }
        if (status == PC_OK && (j->count != vertex_count || w->count != vertex_count)) {
            status = fail(r, "%s and POSITION differ in length", joints);
        } else if (status == PC_OK && j->type == 5126) {
            status = fail(r, "%s are floats", joints);
        }
    }
    return status;
}

// Adds one vertex with its weights; joints without proxy vertex must have no weight.
static pc_status add_vertex(reader *r, const accessor *positions, const influence_sets *sets,
                            size_t v, const uint32_t *vertices, size_t joint_count) {
    double *position = &r->positions[3 * r->count],
           *weights = &r->weights[INFLUENCES_MAX * r->count];
    uint32_t *bones = &r->bones[INFLUENCES_MAX * r->count];
    double sum = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        position[k] = accessor_at(positions, v, k);
        if (!isfinite(position[k])) {
            return fail(r, "position %zu is not finite", v);
        }
    }
    for (size_t k = 0; k < 4 * sets->count; ++k) {
        const size_t joint = (size_t)accessor_at(&sets->joints[k / 4], v, k % 4);
        const double weight = accessor_at(&sets->weights[k / 4], v, k % 4);
        weights[k] = 0.0;
        bones[k] = 0;
        if (!(weight >= 0.0) || !isfinite(weight) || joint >= joint_count) {
            return fail(r, "vertex %zu has weight %g for joint %zu of %zu", v, weight, joint,
                        joint_count);
        }
        if (weight > 0.0 && vertices[joint] == PC_INVALID_INDEX) {
            return fail(r,
                        "no vertex of the proxy is where joint %zu rests; the weights belong to "
                        "another proxy",
                        joint);
        }
        if (weight > 0.0) {
            weights[k] = weight;
            bones[k] = vertices[joint];
            sum += weight;
        }
    }
    for (size_t k = 4 * sets->count; k < INFLUENCES_MAX; ++k) {
        weights[k] = 0.0;
        bones[k] = 0;
    }
    if (!(sum > 0.0)) {
        return fail(r, "vertex %zu has no weight", v);
    }
    ++r->count;
    return PC_OK;
}

static pc_status add_primitive(reader *r, const cJSON *primitive, const uint32_t *vertices,
                               size_t joint_count) {
    const cJSON *attributes = cJSON_GetObjectItemCaseSensitive(primitive, "attributes");
    if (!cJSON_HasObjectItem(attributes, "JOINTS_0")) {
        return PC_OK;
    }
    accessor positions = {0};
    influence_sets sets = {0};
    pc_status status =
        open_accessor(r, get_count(attributes, "POSITION", SIZE_MAX), "VEC3", 3, &positions);
    if (status == PC_OK && positions.type != 5126) {
        status = fail(r, "positions are not floats");
    }
    if (status == PC_OK) {
        status = open_sets(r, attributes, positions.count, &sets);
    }
    if (status != PC_OK) {
        return status;
    }
    void *grown[3] = {r->positions, r->bones, r->weights};
    const size_t needed = r->count + positions.count;
    if (needed > LARGEST_VERTICES) {
        return fail(r, "more than %zu skinned vertices", LARGEST_VERTICES);
    }
    if (!pci_scratch_reserve(&r->scratch, &grown[0], &r->position_capacity, 3 * needed,
                             sizeof(double)) ||
        !pci_scratch_reserve(&r->scratch, &grown[1], &r->bone_capacity, INFLUENCES_MAX * needed,
                             sizeof(uint32_t)) ||
        !pci_scratch_reserve(&r->scratch, &grown[2], &r->weight_capacity, INFLUENCES_MAX * needed,
                             sizeof(double))) {
        return pci_fail_memory(r->context, STAGE);
    }
    r->positions = grown[0], r->bones = grown[1], r->weights = grown[2];
    for (size_t v = 0; v < positions.count && status == PC_OK; ++v) {
        status = add_vertex(r, &positions, &sets, v, vertices, joint_count);
    }
    return status;
}

// All skinned meshes of the file, in the order of the nodes.
static pc_status read_meshes(reader *r) {
    const cJSON *node, *primitive;
    pci_knn proxy;
    if (!pci_knn_build(&r->scratch, r->proxy->vertex_count, r->proxy->positions, &proxy)) {
        return pci_fail_memory(r->context, STAGE);
    }
    pc_status status = PC_OK;
    cJSON_ArrayForEach(node, cJSON_GetObjectItemCaseSensitive(r->json, "nodes")) {
        const cJSON *mesh = get_element(r->json, "meshes", get_count(node, "mesh", SIZE_MAX));
        const cJSON *skin = get_element(r->json, "skins", get_count(node, "skin", SIZE_MAX));
        if (mesh == NULL || skin == NULL || status != PC_OK) {
            continue;
        }
        uint32_t *vertices = NULL;
        size_t joint_count = 0;
        status = match_joints(r, &proxy, skin, &vertices, &joint_count);
        cJSON_ArrayForEach(primitive, cJSON_GetObjectItemCaseSensitive(mesh, "primitives")) {
            if (status == PC_OK) {
                status = add_primitive(r, primitive, vertices, joint_count);
            }
        }
    }
    return status == PC_OK && r->count == 0 ? fail(r, "nothing in the file is skinned") : status;
}

// ---- result -------------------------------------------------------------------------------------

// Merges equal bones and sorts by falling weight; returns the number of influences.
static uint32_t gather_row(const uint32_t *bones, const double *weights, uint32_t *to_bones,
                           double *to_weights) {
    uint32_t used = 0;
    double sum = 0.0;
    for (size_t k = 0; k < INFLUENCES_MAX; ++k) {
        if (weights[k] <= 0.0) {
            continue;
        }
        uint32_t at = 0;
        while (at < used && to_bones[at] != bones[k]) {
            ++at;
        }
        to_weights[at] = weights[k] + (at < used ? to_weights[at] : 0.0);
        to_bones[at] = bones[k];
        used += at == used;
        sum += weights[k];
        for (; at > 0 && to_weights[at - 1] < to_weights[at]; --at) {
            const uint32_t bone = to_bones[at];
            const double weight = to_weights[at];
            to_bones[at] = to_bones[at - 1], to_weights[at] = to_weights[at - 1];
            to_bones[at - 1] = bone, to_weights[at - 1] = weight;
        }
    }
    for (uint32_t k = 0; k < used; ++k) {
        to_weights[k] /= sum;
    }
    return used;
}

static pc_status write_rows(reader *r, pc_skin *skin) {
    const size_t nv = r->surface->vertex_count;
    pci_knn knn;
    uint32_t *rows = PCI_SCRATCH(&r->scratch, uint32_t, nv);
    if (rows == NULL || !pci_knn_build(&r->scratch, r->count, r->positions, &knn)) {
        return pci_fail_memory(r->context, STAGE);
    }
    uint32_t bones[INFLUENCES_MAX], most = 1;
    double weights[INFLUENCES_MAX];
    const double reach = VERTEX_REACH * r->diagonal;
    for (size_t v = 0; v < nv; ++v) {
        double squared = INFINITY;
        pci_knn_query(&knn, &r->surface->positions[3 * v], 1, PC_INVALID_INDEX, &rows[v], &squared);
        if (!(squared <= reach * reach)) {
            return fail(r,
                        "no skinned vertex is where vertex %zu of the visual mesh is; the weights "
                        "belong to another garment",
                        v);
        }
        const size_t from = INFLUENCES_MAX * (size_t)rows[v];
        const uint32_t used = gather_row(&r->bones[from], &r->weights[from], bones, weights);
        most = used > most ? used : most;
    }
    skin->vertex_count = nv;
    skin->influences = most;
    skin->bones = PCI_ALLOCATE(r->context, uint32_t, nv * most);
    skin->weights = PCI_ALLOCATE(r->context, double, nv *most);
    if (skin->bones == NULL || skin->weights == NULL) {
        return pci_fail_memory(r->context, STAGE);
    }
    for (size_t v = 0; v < nv; ++v) {
        const size_t from = INFLUENCES_MAX * (size_t)rows[v];
        const uint32_t used = gather_row(&r->bones[from], &r->weights[from], bones, weights);
        for (uint32_t k = 0; k < most; ++k) {
            skin->bones[v * most + k] = bones[k < used ? k : 0];
            skin->weights[v * most + k] = k < used ? weights[k] : 0.0;
        }
    }
    return PC_OK;
}

pc_status pc_skin_read_glb(pc_context *context, const char *path, const pc_mesh *surface,
                           const pc_mesh *proxy, pc_skin *skin) {
    if (path == NULL || skin == NULL || skin->bones != NULL || skin->weights != NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, STAGE,
                        STAGE ": the path is NULL or the output is not empty");
    }
    pc_status status = pci_check_mesh(context, STAGE, surface, "visual mesh");
    if (status == PC_OK) {
        status = pci_check_mesh(context, STAGE, proxy, "proxy mesh");
    }
    if (status != PC_OK) {
        return status;
    }
    reader r = {.context = context,
                .path = path,
                .scratch = pci_scratch_begin(context),
                .surface = surface,
                .proxy = proxy,
                .diagonal = pci_diagonal(surface)};
    status = open_container(&r);
    if (status == PC_OK) {
        status = read_meshes(&r);
    }
    if (status == PC_OK) {
        status = write_rows(&r, skin);
    }
    if (status != PC_OK) {
        pc_skin_free(context, skin);
    }
    cJSON_Delete(r.json);
    pci_scratch_end(&r.scratch);
    return status;
}
