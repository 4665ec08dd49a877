// Scene file -> flat buffer. Runs in the import child, so it frees nothing and may be killed at any
// time.
#define _POSIX_C_SOURCE 200809L
#include "import_reader.h"

#include <errno.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <assimp/cimport.h>
#include <assimp/config.h>
#include <assimp/material.h>
#include <assimp/postprocess.h>

// All corner attributes, compared as bytes; no padding.
typedef struct corner_data {
    double position[3];
    float normal[3], texcoord[2], color[4];
    uint32_t zero;
} corner_data;

// ---- units and axes -----------------------------------------------------------------------------

static bool metadata_number(const struct aiMetadata *data, const char *key, double *number) {
    for (unsigned i = 0; data != NULL && i < data->mNumProperties; ++i) {
        const struct aiMetadataEntry *entry = &data->mValues[i];
        if (strcmp(data->mKeys[i].data, key) != 0) {
            continue;
        }
        switch (entry->mType) {
        case AI_INT32:
            *number = *(const int32_t *)entry->mData;
            return true;
        case AI_FLOAT:
            *number = (double)*(const float *)entry->mData;
            return true;
        case AI_DOUBLE:
            *number = *(const double *)entry->mData;
            return true;
        default:
            return false;
        }
    }
    return false;
}

// The map from the file's axes and unit to metres with y up. COLLADA files come converted, glTF
// needs nothing, and the other formats know no units.
static affine scene_map(const struct aiScene *source, scene_format format) {
    static const char *const names[3][2] = {
        {"CoordAxis", "CoordAxisSign"}, {"UpAxis", "UpAxisSign"}, {"FrontAxis", "FrontAxisSign"}};
    affine map = affine_identity;
    if (format != SCENE_FBX) {
        return map;
    }
    // FBX counts in centimetres, times a factor. assimp 5.2 leaves factor and axes to the caller;
    // later versions put them into the root's transform.
    map.m[0] = map.m[5] = map.m[10] = 0.01;
    const affine root = affine_from_assimp(&source->mRootNode->mTransformation);
    if (!affine_is_identity(&root)) {
        return map;
    }
    double factor = 1.0, unused[9];
    if (!metadata_number(source->mMetaData, "UnitScaleFactor", &factor) ||
        !(factor > 1e-12 && factor < 1e12)) {
        factor = 1.0;
    }
    affine axes = {{0}};
    for (size_t row = 0; row < 3; ++row) {
        double axis = -1.0, sign = 0.0;
        (void)metadata_number(source->mMetaData, names[row][0], &axis);
        (void)metadata_number(source->mMetaData, names[row][1], &sign);
        for (size_t k = 0; k < 3; ++k) {
            axes.m[4 * row + k] = axis == (double)k ? sign * 0.01 * factor : 0.0;
        }
    }
    // Anything but a rotation means that the file does not say.
    map.m[0] = map.m[5] = map.m[10] = 0.01 * factor;
    return affine_cofactors(&axes, unused) > 0.0 ? axes : map;
}

// ---- parts --------------------------------------------------------------------------------------

static void transform_point(const affine *a, const struct aiVector3D *v, double out[3]) {
    if (affine_is_identity(a)) { // a NaN stays in its coordinate
        out[0] = (double)v->x, out[1] = (double)v->y, out[2] = (double)v->z;
        return;
    }
    for (size_t k = 0; k < 3; ++k) {
        const double *row = &a->m[4 * k];
        out[k] = row[0] * (double)v->x + row[1] * (double)v->y + row[2] * (double)v->z + row[3];
    }
}

// Normals turn with the inverse transpose; its length does not matter.
static void transform_normal(const affine *a, const struct aiVector3D *v, float out[3]) {
    double c[9], normal[3];
    const double sign = affine_cofactors(a, c) < 0.0 ? -1.0 : 1.0;
    double length = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        normal[k] = sign * (c[3 * k] * (double)v->x + c[3 * k + 1] * (double)v->y +
                            c[3 * k + 2] * (double)v->z);
        length += normal[k] * normal[k];
    }
    length = sqrt(length);
    for (size_t k = 0; k < 3; ++k) {
        out[k] = (float)(length > 0.0 ? normal[k] / length : 0.0);
    }
}

static uint64_t hash_corner(const corner_data *c) {
    const unsigned char *bytes = (const unsigned char *)c;
    uint64_t hash = 14695981039346656037u;
    for (size_t i = 0; i < sizeof(*c); ++i) {
        hash = (hash ^ bytes[i]) * 1099511628211u;
    }
    return hash ^ hash >> 32;
}

// Numbers distinct corners in the order of their first appearance: importers repeat a vertex for
// every face that uses it.
static size_t join_corners(scene_reader *reader, const corner_data *corners, size_t count,
                           uint32_t *numbers, uint32_t *firsts) {
    size_t slots = 16;
    while (slots < 2 * count) {
        slots *= 2;
    }
    uint32_t *table = import_allocate(reader, slots, sizeof(*table)); // number + 1
    size_t distinct = 0;
    for (size_t v = 0; v < count; ++v) {
        size_t slot = (size_t)hash_corner(&corners[v]) & (slots - 1);
        while (table[slot] != 0 &&
               memcmp(&corners[firsts[table[slot] - 1]], &corners[v], sizeof(*corners)) != 0) {
            slot = (slot + 1) & (slots - 1);
        }
        if (table[slot] == 0) {
            firsts[distinct] = (uint32_t)v;
            table[slot] = (uint32_t)++distinct;
        }
        numbers[v] = table[slot] - 1;
    }
    free(table);
    return distinct;
}

// Adds what the morph targets of a glTF file change; its weights are those at rest.
static void morph(struct aiVector3D *vector, const struct aiVector3D *target, float weight,
                  const struct aiVector3D *base) {
    if (target != NULL && weight != 0.0F) {
        vector->x += weight * (target->x - base->x);
        vector->y += weight * (target->y - base->y);
        vector->z += weight * (target->z - base->z);
    }
}

// glTF colors without alpha come with alpha 0.
static bool lacks_alpha(const struct aiMesh *mesh) {
    bool lacks = mesh->mColors[0] != NULL;
    for (unsigned v = 0; v < mesh->mNumVertices && lacks; ++v) {
        lacks = mesh->mColors[0][v].a == 0.0F;
    }
    return lacks;
}

static void read_corner(const struct aiMesh *mesh, size_t v, const affine *map, bool morphed,
                        bool opaque, corner_data *out) {
    const struct aiVector3D zero = {0}, *base = &mesh->mVertices[v];
    const struct aiVector3D *base_normal = mesh->mNormals != NULL ? &mesh->mNormals[v] : &zero;
    struct aiVector3D position = *base, normal = *base_normal;
    for (unsigned i = 0; i < mesh->mNumAnimMeshes && morphed; ++i) {
        const struct aiAnimMesh *target = mesh->mAnimMeshes[i];
        if (v < target->mNumVertices) {
            morph(&position, target->mVertices != NULL ? &target->mVertices[v] : NULL,
                  target->mWeight, base);
            morph(&normal, target->mNormals != NULL ? &target->mNormals[v] : NULL, target->mWeight,
                  base_normal);
        }
    }
    transform_point(map, &position, out->position);
    if (mesh->mNormals != NULL) {
        transform_normal(map, &normal, out->normal);
    }
    if (mesh->mTextureCoords[0] != NULL) {
        // assimp's origin is bottom left, ours top left.
        out->texcoord[0] = mesh->mTextureCoords[0][v].x;
        out->texcoord[1] = 1.0F - mesh->mTextureCoords[0][v].y;
    }
    const struct aiColor4D *color = mesh->mColors[0] != NULL ? &mesh->mColors[0][v] : NULL;
    const float rgba[4] = {color != NULL ? color->r : 1.0F, color != NULL ? color->g : 1.0F,
                           color != NULL ? color->b : 1.0F,
                           color != NULL && !opaque ? color->a : 1.0F};
    memcpy(out->color, rgba, sizeof(rgba));
}

static void reserve(scene_reader *reader, size_t vertices, size_t triangles) {
    scene_data *s = &reader->scene;
    size_t capacity = reader->vertex_capacity;
    s->positions = import_grow(reader, s->positions, &capacity, vertices, 3 * sizeof(double));
    capacity = reader->vertex_capacity;
    s->normals = import_grow(reader, s->normals, &capacity, vertices, 3 * sizeof(float));
    capacity = reader->vertex_capacity;
    s->vertex_joints =
        import_grow(reader, s->vertex_joints, &capacity, vertices, 4 * sizeof(uint32_t));
    capacity = reader->vertex_capacity;
    s->vertex_weights =
        import_grow(reader, s->vertex_weights, &capacity, vertices, 4 * sizeof(float));
    capacity = reader->vertex_capacity;
    s->texcoords = import_grow(reader, s->texcoords, &capacity, vertices, 2 * sizeof(float));
    s->colors =
        import_grow(reader, s->colors, &reader->vertex_capacity, vertices, 4 * sizeof(float));
    s->triangles = import_grow(reader, s->triangles, &reader->triangle_capacity, triangles,
                               3 * sizeof(uint32_t));
}

static void store_vertices(scene_data *s, const corner_data *corners, const uint32_t *joints,
                           const float *weights, const uint32_t *firsts, size_t count) {
    for (size_t i = 0, v = s->header.vertex_count; i < count; ++i, ++v) {
        const corner_data *c = &corners[firsts[i]];
        memcpy(&s->positions[3 * v], c->position, sizeof(c->position));
        memcpy(&s->normals[3 * v], c->normal, sizeof(c->normal));
        memcpy(&s->texcoords[2 * v], c->texcoord, sizeof(c->texcoord));
        memcpy(&s->colors[4 * v], c->color, sizeof(c->color));
        memcpy(&s->vertex_joints[4 * v], &joints[4 * firsts[i]], 4 * sizeof(*joints));
        memcpy(&s->vertex_weights[4 * v], &weights[4 * firsts[i]], 4 * sizeof(*weights));
    }
}

static void store_triangles(scene_reader *reader, const struct aiMesh *mesh,
                            const uint32_t *numbers, bool mirrored) {
    scene_data *s = &reader->scene;
    for (unsigned f = 0; f < mesh->mNumFaces; ++f) {
        const struct aiFace *face = &mesh->mFaces[f];
        if (face->mNumIndices != 3) {
            continue; // points and lines
        }
        uint32_t *triangle = &s->triangles[3 * s->header.triangle_count++];
        for (size_t k = 0; k < 3; ++k) {
            const unsigned v = face->mIndices[mirrored && k != 0 ? 3 - k : k];
            if (v >= mesh->mNumVertices) {
                import_fail(reader, "a face refers to vertex %u of %u; export it again", v,
                            mesh->mNumVertices);
            }
            triangle[k] = (uint32_t)(s->header.vertex_count + numbers[v]);
        }
    }
}

static void add_part(scene_reader *reader, const node_entry *entry, const struct aiMesh *mesh,
                     const node_entry *by_name) {
    scene_data *s = &reader->scene;
    const size_t count = mesh->mNumVertices;
    if (s->header.vertex_count + count >= UINT32_MAX / 2 ||
        s->header.triangle_count + mesh->mNumFaces >= UINT32_MAX / 6) {
        import_fail(reader, "more than 2^31 elements");
    }
    corner_data *corners = import_allocate(reader, count, sizeof(*corners));
    uint32_t *numbers = import_allocate(reader, count, sizeof(*numbers));
    uint32_t *firsts = import_allocate(reader, count, sizeof(*firsts));
    uint32_t *joints = import_allocate(reader, count, 4 * sizeof(*joints));
    float *weights = import_allocate(reader, count, 4 * sizeof(*weights));
    affine *maps =
        mesh->mNumBones != 0 ? import_skin_maps(reader, mesh, &entry->world, by_name) : NULL;
    import_weights(reader, mesh, entry, by_name, joints, weights);
    const bool opaque = lacks_alpha(mesh);
    for (size_t v = 0; v < count; ++v) {
        read_corner(mesh, v, maps != NULL ? &maps[v] : &entry->world, reader->morphed, opaque,
                    &corners[v]);
    }
    const size_t distinct = join_corners(reader, corners, count, numbers, firsts);
    reserve(reader, s->header.vertex_count + distinct, s->header.triangle_count + mesh->mNumFaces);
    s->parts = import_grow(reader, s->parts, &reader->part_capacity, s->header.part_count + 1,
                           sizeof(*s->parts));
    scene_part *part = &s->parts[s->header.part_count++];
    cli_clean_text(part->node, sizeof(part->node), entry->node->mName.data);
    cli_clean_text(part->mesh, sizeof(part->mesh), mesh->mName.data);
    part->first_vertex = s->header.vertex_count;
    part->vertex_count = distinct;
    part->first_triangle = s->header.triangle_count;
    part->material =
        mesh->mMaterialIndex < reader->source->mNumMaterials ? mesh->mMaterialIndex : 0;
    part->bone_count = mesh->mNumBones;
    part->has_normals = mesh->mNormals != NULL;
    part->has_texcoords = mesh->mTextureCoords[0] != NULL;
    part->has_colors = mesh->mColors[0] != NULL;
    // A mirrored part is turned inside out again. One vertex stands for a skinned part.
    double unused[9];
    const affine *sample = maps != NULL && count != 0 ? &maps[0] : &entry->world;
    store_triangles(reader, mesh, numbers, affine_cofactors(sample, unused) < 0.0);
    store_vertices(s, corners, joints, weights, firsts, distinct);
    s->header.vertex_count += distinct;
    part->triangle_count = s->header.triangle_count - part->first_triangle;
    free(corners);
    free(joints);
    free(weights);
    free(numbers);
    free(firsts);
    free(maps);
}

// ---- materials and animations -------------------------------------------------------------------

static float material_number(const struct aiMaterial *material, const char *key, unsigned type,
                             unsigned index, float fallback) {
    ai_real value = fallback;
    unsigned count = 1;
    return aiGetMaterialFloatArray(material, key, type, index, &value, &count) == aiReturn_SUCCESS
               ? value
               : fallback;
}

static void read_materials(scene_reader *reader) {
    scene_data *s = &reader->scene;
    const size_t count = reader->source->mNumMaterials;
    s->header.material_count = count != 0 ? count : 1;
    s->materials = import_allocate(reader, s->header.material_count, sizeof(*s->materials));
    for (size_t m = 0; m < s->header.material_count; ++m) {
        pc_material *out = &s->materials[m];
        const pc_material white = {.base_color = {1.0F, 1.0F, 1.0F, 1.0F}, .roughness = 1.0F};
        *out = white;
        if (count == 0) {
            continue;
        }
        const struct aiMaterial *in = reader->source->mMaterials[m];
        struct aiString name = {0};
        if (aiGetMaterialString(in, AI_MATKEY_NAME, &name) == aiReturn_SUCCESS) {
            cli_clean_text(out->name, sizeof(out->name), name.data);
        }
        struct aiColor4D color;
        const bool base = aiGetMaterialColor(in, AI_MATKEY_BASE_COLOR, &color) == aiReturn_SUCCESS;
        if (base || aiGetMaterialColor(in, AI_MATKEY_COLOR_DIFFUSE, &color) == aiReturn_SUCCESS) {
            const float opacity = base ? 1.0F : material_number(in, AI_MATKEY_OPACITY, 1.0F);
            const float rgba[4] = {color.r, color.g, color.b, color.a * opacity};
            memcpy(out->base_color, rgba, sizeof(rgba));
        }
        out->metallic = material_number(in, AI_MATKEY_METALLIC_FACTOR, 0.0F);
        out->roughness = material_number(in, AI_MATKEY_ROUGHNESS_FACTOR, 1.0F);
        int two_sided = 0;
        unsigned one = 1;
        out->double_sided = aiGetMaterialIntegerArray(in, AI_MATKEY_TWOSIDED, &two_sided, &one) ==
                                aiReturn_SUCCESS &&
                            two_sided != 0;
    }
}

static void read_animations(scene_reader *reader) {
    scene_data *s = &reader->scene;
    s->header.animation_count = reader->source->mNumAnimations;
    s->animations = import_allocate(reader, s->header.animation_count, sizeof(*s->animations));
    for (size_t a = 0; a < s->header.animation_count; ++a) {
        const struct aiAnimation *in = reader->source->mAnimations[a];
        cli_clean_text(s->animations[a].name, sizeof(s->animations[a].name), in->mName.data);
        s->animations[a].seconds =
            in->mTicksPerSecond > 0.0 ? in->mDuration / in->mTicksPerSecond : in->mDuration;
        s->animations[a].channels = in->mNumChannels;
    }
}

// ---- files --------------------------------------------------------------------------------------

static char *read_file(scene_reader *reader, const char *path, size_t *size) {
    FILE *file = fopen(path, "rb");
    if (file == NULL) {
        import_fail(reader, "%s", strerror(errno));
    }
    char *bytes = NULL;
    size_t capacity = 0, count = 1;
    for (*size = 0; count != 0; *size += count) {
        bytes = import_grow(reader, bytes, &capacity, *size + 65536, 1);
        count = fread(bytes + *size, 1, capacity - *size, file);
    }
    if (ferror(file)) {
        import_fail(reader, "%s", strerror(errno));
    }
    fclose(file);
    return bytes;
}

// Faces of glTF files whose indices are out of range are left out with no more than a warning.
static void hear_warning(const char *message, char *faces_dropped) {
    *faces_dropped |= strstr(message, "Those faces were dropped") != NULL;
}

static const struct aiScene *import(scene_reader *reader, const char *path, scene_format format) {
    char faces_dropped = 0;
    const struct aiLogStream warnings = {.callback = hear_warning, .user = &faces_dropped};
    const unsigned flags = aiProcess_Triangulate;
    struct aiPropertyStore *store = aiCreatePropertyStore();
    aiSetImportPropertyInteger(store, AI_CONFIG_IMPORT_NO_SKELETON_MESHES, 1);
    aiSetImportPropertyInteger(store, AI_CONFIG_IMPORT_COLLADA_USE_COLLADA_NAMES, 1);
    aiSetImportPropertyInteger(store, AI_CONFIG_IMPORT_FBX_PRESERVE_PIVOTS, 0);
    size_t size = 0;
    char *bytes = read_file(reader, path, &size);
    char message[200] = "", *plain = bytes;
    if (format == SCENE_GLB || format == SCENE_GLTF) {
        plain = scene_plain_gltf(path, bytes, &size, format, message, sizeof(message));
        format = SCENE_GLB;
        aiAttachLogStream(&warnings);
    } else if (format == SCENE_OBJ) {
        plain = scene_plain_obj(path, bytes, &size, message, sizeof(message));
    } else if (format == SCENE_PLY) {
        (void)scene_check_ply(bytes, size, message, sizeof(message));
    } else if (format == SCENE_STL) {
        (void)scene_check_stl(bytes, &size, message, sizeof(message));
    }
    if (message[0] != '\0') {
        import_fail(reader, "%s", message);
    }
    if (plain != bytes) {
        free(bytes);
        bytes = plain;
    }
    if (size > UINT32_MAX) {
        import_fail(reader, "the file is larger than 4 GiB");
    }
    // From memory, where the hint decides about the importer.
    const struct aiScene *source = aiImportFileFromMemoryWithProperties(
        bytes, (unsigned)size, flags, scene_format_extension(format), store);
    free(bytes);
    (void)aiDetachLogStream(&warnings);
    if (source == NULL || source->mRootNode == NULL) {
        const char *reason = aiGetErrorString();
        reason = reason != NULL && reason[0] != '\0' ? reason : "it is damaged";
        const size_t length = strlen(reason);
        import_fail(reader, "the file cannot be read: %.*s; export it again",
                    (int)(length - (reason[length - 1] == '.')), reason);
    }
    if (faces_dropped) {
        import_fail(reader, "a face refers to a vertex that does not exist; export it again");
    }
    return source;
}

static void send(scene_reader *reader) {
    scene_data *s = &reader->scene;
    uint64_t at[SCENE_ARRAYS + 1];
    memcpy(s->header.magic, SCENE_MAGIC, sizeof(s->header.magic));
    if (!scene_layout(&s->header, at)) {
        import_fail(reader, "more than 2^31 elements");
    }
    s->header.size = at[SCENE_ARRAYS];
    const scene_header *h = &s->header;
    const struct {
        const void *array;
        size_t size;
    } arrays[SCENE_ARRAYS] = {{s->parts, h->part_count * sizeof(scene_part)},
                              {s->materials, h->material_count * sizeof(pc_material)},
                              {s->animations, h->animation_count * sizeof(scene_animation)},
                              {s->positions, h->vertex_count * 3 * sizeof(double)},
                              {s->normals, h->vertex_count * 3 * sizeof(float)},
                              {s->texcoords, h->vertex_count * 2 * sizeof(float)},
                              {s->colors, h->vertex_count * 4 * sizeof(float)},
                              {s->triangles, h->triangle_count * 3 * sizeof(uint32_t)},
                              {s->joints, h->joint_count * sizeof(scene_joint)},
                              {s->poses, h->pose_count * h->joint_count * 12 * sizeof(float)},
                              {s->vertex_joints, h->vertex_count * 4 * sizeof(uint32_t)},
                              {s->vertex_weights, h->vertex_count * 4 * sizeof(float)}};
    const char zeros[8] = {0};
    import_write(reader->descriptor, &s->header, sizeof(s->header));
    for (size_t i = 0; i < SCENE_ARRAYS; ++i) {
        import_write(reader->descriptor, arrays[i].array, arrays[i].size);
        import_write(reader->descriptor, zeros, (size_t)(at[i + 1] - at[i]) - arrays[i].size);
    }
}

int scene_read(const char *path, scene_format format, int descriptor) {
    scene_reader reader = {.descriptor = descriptor,
                           .morphed = format == SCENE_GLTF || format == SCENE_GLB};
    reader.source = import(&reader, path, format);
    scene_data *s = &reader.scene;
    strncpy(s->header.format, scene_format_name(format), sizeof(s->header.format) - 1);
    reader.map = scene_map(reader.source, format);
    import_nodes(&reader, reader.source->mRootNode, SIZE_MAX);
    const node_entry *by_name = import_sort_nodes(&reader);
    read_materials(&reader);
    import_joints(&reader, by_name);
    read_animations(&reader);
    import_poses(&reader);
    for (size_t n = 0; n < s->header.node_count; ++n) {
        const struct aiNode *node = reader.nodes[n].node;
        for (unsigned i = 0; i < node->mNumMeshes; ++i) {
            if (node->mMeshes[i] < reader.source->mNumMeshes) {
                add_part(&reader, &reader.nodes[n], reader.source->mMeshes[node->mMeshes[i]],
                         by_name);
            }
        }
    }
    send(&reader);
    return CLI_OK;
}
