// An asset file -> an asset. Nothing in the file is trusted.

#include "io/asset_hdf5.h"
#include "io/atomic_file.h"
#include "proxycloth/version.h"

#define STAGE PCI_ASSET_STAGE

// Whether the attribute is there and has the expected type and length.
static bool read_attribute(pci_asset_file *file, hid_t owner, const char *name, hid_t stored,
                           hid_t wanted, uint32_t length, void *values) {
    const hid_t attribute = H5Aopen(owner, name, H5P_DEFAULT);
    const hid_t type = H5Aget_type(attribute);
    const hid_t space = H5Aget_space(attribute);
    hsize_t size = 1;
    bool good = false;
    if (attribute < 0 || type < 0 || space < 0) {
        pci_asset_hdf5_failed(file, name);
    } else if (H5Tequal(type, stored) <= 0 ||
               H5Sget_simple_extent_ndims(space) != (length == 1 ? 0 : 1) ||
               H5Sget_simple_extent_dims(space, &size, NULL) < 0 ||
               H5Sget_simple_extent_npoints(space) != (hssize_t)length) {
        pci_asset_damaged(file, name, "has another type");
    } else {
        good = H5Aread(attribute, wanted, values) >= 0 || pci_asset_hdf5_failed(file, name);
    }
    H5Sclose(space);
    H5Tclose(type);
    H5Aclose(attribute);
    return good;
}

static bool read_numbers(pci_asset_file *file, hid_t owner, const char *name, pci_element element,
                         uint32_t length, void *values) {
    return read_attribute(file, owner, name, pci_asset_file_type(element),
                          pci_asset_memory_type(element), length, values);
}

// A text of at most PCI_TEXT_LIMIT bytes with its end.
static bool read_text(pci_asset_file *file, hid_t owner, const char *name,
                      char text[PCI_TEXT_LIMIT]) {
    memset(text, 0, PCI_TEXT_LIMIT);
    const hid_t attribute = H5Aopen(owner, name, H5P_DEFAULT);
    const hid_t type = H5Aget_type(attribute);
    const size_t size = H5Tget_size(type);
    const bool expected = H5Tget_class(type) == H5T_STRING && H5Tis_variable_str(type) == 0 &&
                          size >= 1 && size <= PCI_TEXT_LIMIT;
    H5Tclose(type);
    H5Aclose(attribute);
    if (!expected) {
        return pci_asset_damaged(file, name, "is not a text");
    }
    const hid_t wanted = pci_asset_text_type(size);
    const bool good = read_attribute(file, owner, name, wanted, wanted, 1, text);
    H5Tclose(wanted);
    return good && (text[size - 1] == '\0' || pci_asset_damaged(file, name, "does not end"));
}

static bool has_attribute(hid_t owner, const char *name) { return H5Aexists(owner, name) > 0; }

// Only objects of this very file: a link could lead to any file of the reader's disk.
static bool has_object(hid_t parent, const char *name) {
    H5L_info_t info;
    return H5Lexists(parent, name, H5P_DEFAULT) > 0 &&
           H5Lget_info(parent, name, &info, H5P_DEFAULT) >= 0 && info.type == H5L_TYPE_HARD;
}

// `open`: H5Gopen2 or H5Dopen2.
static hid_t open_object(pci_asset_file *file, hid_t parent, const char *name,
                         hid_t (*open)(hid_t, const char *, hid_t)) {
    if (!has_object(parent, name)) {
        pci_asset_damaged(file, name, "is missing");
        return H5I_INVALID_HID;
    }
    const hid_t object = open(parent, name, H5P_DEFAULT);
    if (object < 0) {
        pci_asset_hdf5_failed(file, name);
    }
    return object;
}

static bool read_choice(pci_asset_file *file, hid_t group, const pc_field *field,
                        uint32_t *choice) {
    char text[PCI_TEXT_LIMIT];
    if (!read_text(file, group, field->name, text)) {
        return false;
    }
    for (uint32_t i = 0; field->choices[i] != NULL; ++i) {
        if (strcmp(field->choices[i], text) == 0) {
            *choice = i;
            return true;
        }
    }
    return pci_asset_damaged(file, field->name, "has an unknown choice");
}

// Fields that the file lacks, because an older library wrote it, keep what `values` holds.
static bool read_record(pci_asset_file *file, hid_t parent, const char *name,
                        const pc_record *record, void *values) {
    const hid_t group = open_object(file, parent, name, H5Gopen2);
    bool good = group >= 0;
    for (size_t i = 0; i < record->field_count && good; ++i) {
        const pc_field *field = &record->fields[i];
        void *at = (char *)values + field->offset;
        if (!has_attribute(group, field->name)) {
            continue;
        }
        if (field->type == PC_FIELD_CHOICE) {
            good = read_choice(file, group, field, at);
        } else if (field->type == PC_FIELD_BOOL) {
            uint8_t flag = 0;
            good = read_numbers(file, group, field->name, PCI_ELEMENT_U8, 1, &flag) &&
                   (flag <= 1 || pci_asset_damaged(file, field->name, "is neither 0 nor 1"));
            *(bool *)at = good && flag != 0;
        } else {
            good = read_numbers(file, group, field->name, pci_asset_field_element(field), 1, at);
        }
    }
    H5Gclose(group);
    return good;
}

// Whether the data lie in this file, unpacked: then no more memory is needed than the file is long.
static bool is_plain(hid_t dataset) {
    const hid_t properties = H5Dget_create_plist(dataset);
    const H5D_layout_t layout = H5Pget_layout(properties);
    const bool plain = (layout == H5D_CONTIGUOUS || layout == H5D_COMPACT) &&
                       H5Pget_external_count(properties) == 0;
    H5Pclose(properties);
    return plain;
}

// The shape of a dataset; false unless it has this type and rank and fits into the file.
static bool read_shape(pci_asset_file *file, hid_t dataset, const char *name, hid_t stored,
                       size_t rank, size_t shape[3]) {
    const hid_t type = H5Dget_type(dataset);
    const hid_t space = H5Dget_space(dataset);
    hsize_t dimensions[3] = {0};
    bool good = H5Tequal(type, stored) > 0 && H5Sget_simple_extent_ndims(space) == (int)rank &&
                H5Sget_simple_extent_dims(space, dimensions, NULL) == (int)rank;
    if (!good) {
        pci_asset_damaged(file, name, "has another type or shape");
    } else if (!is_plain(dataset)) {
        good = pci_asset_damaged(file, name, "is packed or lies outside of the file");
    } else {
        size_t bytes = H5Tget_size(stored);
        for (size_t k = 0; k < rank && good; ++k) {
            shape[k] = (size_t)dimensions[k];
            good = dimensions[k] <= INT32_MAX &&
                   (dimensions[k] == 0 || bytes <= file->image_size / dimensions[k]);
            bytes *= shape[k];
        }
        good = (good && H5Dget_storage_size(dataset) >= bytes) ||
               pci_asset_damaged(file, name, "is larger than the file");
    }
    H5Sclose(space);
    H5Tclose(type);
    return good;
}

// Memory for the rows of a dataset, filled; NULL on failure.
static void *read_rows(pci_asset_file *file, hid_t dataset, const char *name, hid_t wanted,
                       size_t count) {
    void *rows = pci_allocate(file->context, count, H5Tget_size(wanted));
    if (rows == NULL) {
        pci_asset_out_of_memory(file);
    } else if (count > 0 && H5Dread(dataset, wanted, H5S_ALL, H5S_ALL, H5P_DEFAULT, rows) < 0) {
        pci_asset_hdf5_failed(file, name);
        pc_release(file->context, rows);
        rows = NULL;
    }
    return rows;
}

// The first array that uses a count sets it, the others must agree.
static bool agree_on_counts(pc_asset *asset, const pci_array_info *info, const size_t shape[3],
                            bool known[PCI_COUNT_COUNT]) {
    size_t next = 0;
    const pci_count counts[2] = {info->rows, info->columns};
    for (size_t k = 0; k < 2; ++k) {
        const pci_count count = counts[k];
        if (count == PCI_COUNT_NONE) {
            continue;
        }
        if (known[count] && pci_count_get(asset, count) != shape[next]) {
            return false;
        }
        pci_count_set(asset, count, shape[next++]);
        known[count] = true;
    }
    return info->tuple == 1 || shape[next] == info->tuple;
}

static bool read_array(pci_asset_file *file, hid_t group, const pci_array_info *info,
                       pc_asset *asset, bool known[PCI_COUNT_COUNT]) {
    if (info->optional && !has_object(group, info->name)) {
        return true;
    }
    const size_t rank = 1u + (info->columns != PCI_COUNT_NONE) + (info->tuple != 1);
    size_t shape[3] = {1, 1, 1};
    const hid_t dataset = open_object(file, group, info->name, H5Dopen2);
    bool good = dataset >= 0 && read_shape(file, dataset, info->name,
                                           pci_asset_file_type(info->element), rank, shape);
    if (good && !agree_on_counts(asset, info, shape, known)) {
        good = pci_asset_damaged(file, info->name,
                                 "has another number of elements than its neighbours");
    }
    if (good) {
        void *array = read_rows(file, dataset, info->name, pci_asset_memory_type(info->element),
                                shape[0] * shape[1] * shape[2]);
        pci_array_set(asset, info, array);
        good = array != NULL;
    }
    H5Dclose(dataset);
    return good;
}

static bool read_materials(pci_asset_file *file, hid_t group, pc_visual *visual) {
    const hid_t stored = pci_asset_material_type(true), wanted = pci_asset_material_type(false);
    const hid_t dataset = open_object(file, group, "materials", H5Dopen2);
    size_t count[3] = {0};
    pci_stored_material *rows = NULL;
    bool good = dataset >= 0 && read_shape(file, dataset, "materials", stored, 1, count);
    if (good) {
        rows = read_rows(file, dataset, "materials", wanted, count[0]);
        good = rows != NULL;
    }
    if (good) {
        visual->materials = PCI_ALLOCATE(file->context, pc_material, count[0]);
        visual->material_count = count[0];
        good = visual->materials != NULL;
        if (!good) {
            (void)pci_asset_out_of_memory(file);
        }
    }
    for (size_t i = 0; i < count[0] && good; ++i) {
        pc_material *material = &visual->materials[i];
        memcpy(material->name, rows[i].name, sizeof(material->name));
        memcpy(material->base_color, rows[i].base_color, sizeof(material->base_color));
        material->metallic = rows[i].metallic;
        material->roughness = rows[i].roughness;
        material->double_sided = rows[i].double_sided != 0;
        good = rows[i].double_sided <= 1 || pci_asset_damaged(file, "materials", "has a bad flag");
    }
    pc_release(file->context, rows);
    H5Dclose(dataset);
    H5Tclose(wanted);
    H5Tclose(stored);
    return good;
}

static bool read_scenario(pci_asset_file *file, hid_t group, pc_scenario *scenario) {
    if (!has_object(group, "scenario")) {
        return true;
    }
    size_t shape[3] = {0};
    char *text = NULL;
    const hid_t dataset = open_object(file, group, "scenario", H5Dopen2);
    bool good = dataset >= 0 && read_shape(file, dataset, "scenario", H5T_STD_U8LE, 1, shape);
    if (good) {
        text = read_rows(file, dataset, "scenario", H5T_NATIVE_UINT8, shape[0]);
        good = text != NULL;
    }
    if (good) {
        // The text holds no option.
        pc_simulate_options options;
        pc_record_set_defaults(&pc_simulate_options_record, &options);
        const pc_status status =
            pc_scenario_parse(file->context, text, shape[0], "/simulate", &options, scenario);
        good = status == PC_OK || (status == PC_ERROR_OUT_OF_MEMORY
                                       ? pci_asset_out_of_memory(file)
                                       : pci_asset_damaged(file, "scenario", "is no scenario"));
    }
    pc_release(file->context, text);
    H5Dclose(dataset);
    return good;
}

static bool read_group(pci_asset_file *file, pc_asset *asset, int group) {
    bool known[PCI_COUNT_COUNT] = {false};
    known[PCI_COUNT_MATERIALS] = group == 0;
    const hid_t id = open_object(file, file->id, pci_group_name(group), H5Gopen2);
    bool good = id >= 0;
    for (size_t i = 0; i < pci_scalar_count && good; ++i) {
        const pci_scalar_info *info = &pci_scalars[i];
        if (info->group == group && !(info->optional && H5Aexists(id, info->name) == 0)) {
            good = read_numbers(file, id, info->name, info->element, info->length,
                                (char *)asset + info->offset);
        }
    }
    for (size_t i = 0; i < pci_array_count && good; ++i) {
        if (pci_arrays[i].group == group) {
            good = read_array(file, id, &pci_arrays[i], asset, known);
        }
    }
    if (group == PC_STAGE_GRAPH + 1 && !known[PCI_COUNT_GRAPH_VERTICES]) {
        asset->graph.vertex_count = asset->projected.vertex_count;
    }
    if (group == 0) {
        good = good && read_materials(file, id, &asset->visual) &&
               read_record(file, id, "report", &pc_visual_report_record, &asset->reports.visual);
    } else if (good) {
        const pc_stage_info *info = pc_stage_describe((pc_stage)(group - 1));
        void *options = (char *)&asset->options + info->options_offset;
        pc_record_set_defaults(info->options, options);
        good = read_record(file, id, "options", info->options, options) &&
               read_record(file, id, "report", info->report,
                           (char *)&asset->reports + info->report_offset) &&
               (group != PC_STAGE_SIMULATE + 1 || read_scenario(file, id, &asset->scenario));
    }
    H5Gclose(id);
    return good;
}

static bool other_kind(pci_asset_file *file, const char *what) {
    file->status = pci_fail(file->context, PC_ERROR_FORMAT, STAGE,
                            STAGE ": \"%.300s\" is no asset file: %s", file->path, what);
    return false;
}

// HDF5 reads the image where it is, instead of copying it twice.
static void *image_lend(size_t size, H5FD_file_image_op_t operation, void *user) {
    (void)size;
    (void)operation;
    return user;
}
static void *image_keep(void *target, const void *source, size_t size,
                        H5FD_file_image_op_t operation, void *user) {
    (void)source;
    (void)size;
    (void)operation;
    (void)user;
    return target;
}
static herr_t image_leave(void *memory, H5FD_file_image_op_t operation, void *user) {
    (void)memory;
    (void)operation;
    (void)user;
    return 0;
}
static void *image_share_user(void *user) { return user; }
static herr_t image_forget_user(void *user) {
    (void)user;
    return 0;
}

// The image has to stay until the file is closed.
static bool open_file(pci_asset_file *file, unsigned char *image) {
    static const unsigned char signature[] = {0x89, 'H', 'D', 'F', '\r', '\n', 0x1a, '\n'};
    if (file->image_size < 48 + PCI_SEAL_SIZE || memcmp(image, signature, sizeof(signature)) != 0) {
        return other_kind(file, "it is not HDF5");
    }
    file->image_size -= PCI_SEAL_SIZE;
    const unsigned char *seal = image + file->image_size;
    if (memcmp(seal, pci_seal_mark, sizeof(pci_seal_mark)) != 0) {
        return other_kind(file, "it is HDF5 of another kind, was cut off, or was changed by "
                                "another program");
    }
    unsigned char expected[PCI_SEAL_SIZE];
    pci_asset_make_seal(image, file->image_size, expected);
    if (memcmp(seal, expected, PCI_SEAL_SIZE) != 0) {
        return pci_asset_damaged(file, "its checksum", "is wrong");
    }
    char name[32];
    H5FD_file_image_callbacks_t callbacks = {image_lend,       image_keep,        NULL, image_leave,
                                             image_share_user, image_forget_user, image};
    const hid_t access = pci_asset_memory_file_access(file, name);
    if (access >= 0 && H5Pset_file_image_callbacks(access, &callbacks) >= 0 &&
        H5Pset_file_image(access, image, file->image_size) >= 0) {
        file->id = H5Fopen(name, H5F_ACC_RDONLY, access);
    }
    const bool good = file->id >= 0 || pci_asset_hdf5_failed(file, "/");
    H5Pclose(access);
    return good;
}

static bool read_header(pci_asset_file *file, pc_asset *asset) {
    char text[PCI_TEXT_LIMIT];
    uint32_t version = 0;
    if (!has_attribute(file->id, "format") || !read_text(file, file->id, "format", text) ||
        strcmp(text, PCI_FORMAT_TEXT) != 0) {
        return other_kind(file, "it is HDF5 of another kind");
    }
    if (!read_numbers(file, file->id, "format_version", PCI_ELEMENT_U32, 1, &version)) {
        return false;
    }
    if (version > PC_ASSET_FORMAT_VERSION) {
        file->status = pci_fail(file->context, PC_ERROR_FORMAT, STAGE,
                                STAGE ": \"%.200s\" has format version %u, this library (%s) reads "
                                      "up to %d; use a newer proxycloth",
                                file->path, version, PC_VERSION_STRING, PC_ASSET_FORMAT_VERSION);
        return false;
    }
    if (version == 0) {
        return pci_asset_damaged(file, "format_version", "is 0");
    }
    if (!read_text(file, file->id, "name", text) ||
        !read_numbers(file, file->id, "stage_count", PCI_ELEMENT_U32, 1, &asset->stage_count)) {
        return false;
    }
    memcpy(asset->name, text, sizeof(asset->name));
    return asset->stage_count <= PC_STAGE_COUNT ||
           pci_asset_damaged(file, "stage_count", "is out of range");
}

static bool read_asset(pci_asset_file *file, pc_asset *asset) {
    bool good = read_header(file, asset);
    for (int group = 0; good && group <= (int)asset->stage_count; ++group) {
        good = read_group(file, asset, group);
    }
    char problem[256];
    if (good && !pci_asset_check(asset, problem, sizeof(problem))) {
        good = pci_asset_damaged(file, problem, "");
    }
    return good;
}

static bool is_empty(const pc_asset *asset) {
    bool empty = asset->stage_count == 0 && asset->visual.materials == NULL;
    for (size_t i = 0; i < pci_array_count; ++i) {
        empty = empty && pci_array_get(asset, &pci_arrays[i]) == NULL;
    }
    return empty;
}

pc_status pc_asset_load(pc_context *context, const char *path, pc_asset *asset) {
    if (context == NULL) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    if (path == NULL || asset == NULL || !is_empty(asset)) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, STAGE,
                        STAGE ": path or asset is NULL, or the asset is not empty");
    }
    pci_asset_file file = {.context = context, .path = path, .id = H5I_INVALID_HID};
    unsigned char *image = NULL;
    file.status = pci_read_file(context, STAGE, path, &image, &file.image_size);
    if (file.status != PC_OK) {
        return file.status;
    }
    pci_asset_silence_hdf5(&file);
    const bool opened = open_file(&file, image);
    if (!opened || !read_asset(&file, asset)) {
        pc_asset_free(context, asset);
    }
    H5Fclose(file.id);
    pci_asset_restore_hdf5(&file);
    pc_release(context, image);
    return file.status;
}
