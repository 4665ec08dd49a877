// Asset files. HDF5 works on images in memory only, so that reading and writing the disk, with its
// error messages and the renaming of finished files, is the same as for every other format.
#include "proxycloth/asset_file.h"

#include <hdf5.h>
#include <stdio.h>
#include <stdlib.h>

#include "io/asset_table.h"
#include "io/atomic_file.h"
#include "io/scenario_file.h"
#include "proxycloth/version.h"

#define STAGE       "asset"
#define FORMAT_TEXT "proxycloth asset"
#define TEXT_LIMIT  128

// The last bytes of every asset file, behind what HDF5 uses: a mark and the hash of all bytes
// before the seal. Damage is found before HDF5 1.10 sees it, which loses memory over some of it and
// prints when the process ends.
#define SEAL_SIZE 16
static const unsigned char seal_mark[8] = {'p', 'c', '-', 'a', 's', 's', 'e', 't'};

// FNV-1a.
static void make_seal(const unsigned char *bytes, size_t size, unsigned char seal[SEAL_SIZE]) {
    uint64_t hash = 0xcbf29ce484222325u;
    for (size_t i = 0; i < size; ++i) {
        hash = (hash ^ bytes[i]) * 0x100000001b3u;
    }
    memcpy(seal, seal_mark, sizeof(seal_mark));
    for (size_t i = 0; i < 8; ++i) {
        seal[8 + i] = (unsigned char)(hash >> (8 * i));
    }
}

// ---- an open file -----------------------------------------------------------------------------

// What one save or load call holds. The first failure is kept; every function below returns false
// from then on.
typedef struct asset_file {
    pc_context *context;
    const char *path;
    hid_t id;
    size_t image_size; // when reading
    pc_status status;
    H5E_auto2_t error_function; // of the caller, while ours is none
    void *error_data;
} asset_file;

static void silence_hdf5(asset_file *file) {
    H5Eget_auto2(H5E_DEFAULT, &file->error_function, &file->error_data);
    H5Eset_auto2(H5E_DEFAULT, NULL, NULL);
}

static void restore_hdf5(asset_file *file) {
    H5Eclear2(H5E_DEFAULT);
    H5Eset_auto2(H5E_DEFAULT, file->error_function, file->error_data);
}

static herr_t keep_first_cause(unsigned index, const H5E_error2_t *error, void *user) {
    if (index == 0 && error->desc != NULL) {
        snprintf(user, TEXT_LIMIT, "%s", error->desc);
    }
    return 0;
}

// A call to HDF5 failed. When reading, the file is to blame.
static bool hdf5_failed(asset_file *file, const char *object) {
    char cause[TEXT_LIMIT] = "no reason given";
    H5Ewalk2(H5E_DEFAULT, H5E_WALK_UPWARD, keep_first_cause, cause);
    if (file->status == PC_OK) {
        file->status = file->image_size != 0
                           ? pci_fail(file->context, PC_ERROR_FORMAT, STAGE,
                                      STAGE ": \"%.200s\" is damaged at %.100s (HDF5: %s)",
                                      file->path, object, cause)
                           : pci_fail(file->context, PC_ERROR_DEPENDENCY, STAGE,
                                      STAGE ": HDF5 cannot write %.100s: %s", object, cause);
    }
    return false;
}

static bool damaged(asset_file *file, const char *object, const char *problem) {
    if (file->status == PC_OK) {
        file->status =
            pci_fail(file->context, PC_ERROR_FORMAT, STAGE,
                     STAGE ": \"%.200s\" is damaged: %.100s %s", file->path, object, problem);
    }
    return false;
}

static bool out_of_memory(asset_file *file) {
    if (file->status == PC_OK) {
        file->status = pci_fail_memory(file->context, STAGE);
    }
    return false;
}

// Types in the file are little-endian, whatever the machine is.
static hid_t file_type(pci_element element) {
    switch (element) {
    case PCI_ELEMENT_F64:
        return H5T_IEEE_F64LE;
    case PCI_ELEMENT_F32:
        return H5T_IEEE_F32LE;
    case PCI_ELEMENT_U64:
        return H5T_STD_U64LE;
    case PCI_ELEMENT_U32:
        return H5T_STD_U32LE;
    case PCI_ELEMENT_U8:
        return H5T_STD_U8LE;
    case PCI_ELEMENT_I8:
        return H5T_STD_I8LE;
    case PCI_ELEMENT_COUNT:
        break;
    }
    return H5I_INVALID_HID;
}

static hid_t memory_type(pci_element element) {
    switch (element) {
    case PCI_ELEMENT_F64:
        return H5T_NATIVE_DOUBLE;
    case PCI_ELEMENT_F32:
        return H5T_NATIVE_FLOAT;
    case PCI_ELEMENT_U64:
        return H5T_NATIVE_UINT64;
    case PCI_ELEMENT_U32:
        return H5T_NATIVE_UINT32;
    case PCI_ELEMENT_U8:
        return H5T_NATIVE_UINT8;
    case PCI_ELEMENT_I8:
        return H5T_NATIVE_INT8;
    case PCI_ELEMENT_COUNT:
        break;
    }
    return H5I_INVALID_HID;
}

static hid_t text_type(size_t size) {
    const hid_t type = H5Tcopy(H5T_C_S1);
    if (type >= 0 && (H5Tset_size(type, size) < 0 || H5Tset_cset(type, H5T_CSET_UTF8) < 0)) {
        H5Tclose(type);
        return H5I_INVALID_HID;
    }
    return type;
}

// How a field of a record is stored; choices are stored by name.
static pci_element field_element(const pc_field *field) {
    switch (field->type) {
    case PC_FIELD_DOUBLE:
        return PCI_ELEMENT_F64;
    case PC_FIELD_UINT:
    case PC_FIELD_CHOICE:
        return PCI_ELEMENT_U32;
    case PC_FIELD_COUNT:
        return PCI_ELEMENT_U64;
    case PC_FIELD_BOOL:
        break;
    }
    return PCI_ELEMENT_U8;
}

// A material as a row of a table; pc_material has a bool, which not every byte is.
typedef struct stored_material {
    char name[sizeof(((pc_material *)0)->name)];
    float base_color[4];
    float metallic;
    float roughness;
    uint8_t double_sided;
} stored_material;

// The row's type in memory, or packed and little-endian in the file.
static hid_t material_type(bool in_file) {
    static const hsize_t four = 4;
    const hid_t real = in_file ? H5T_IEEE_F32LE : H5T_NATIVE_FLOAT;
    const hid_t flag = in_file ? H5T_STD_U8LE : H5T_NATIVE_UINT8;
    const hid_t text = text_type(sizeof(((stored_material *)0)->name));
    const hid_t color = H5Tarray_create2(real, 1, &four);
    hid_t type = H5Tcreate(H5T_COMPOUND, sizeof(stored_material));
    if (H5Tinsert(type, "name", HOFFSET(stored_material, name), text) < 0 ||
        H5Tinsert(type, "base_color", HOFFSET(stored_material, base_color), color) < 0 ||
        H5Tinsert(type, "metallic", HOFFSET(stored_material, metallic), real) < 0 ||
        H5Tinsert(type, "roughness", HOFFSET(stored_material, roughness), real) < 0 ||
        H5Tinsert(type, "double_sided", HOFFSET(stored_material, double_sided), flag) < 0 ||
        (in_file && H5Tpack(type) < 0)) {
        H5Tclose(type);
        type = H5I_INVALID_HID;
    }
    H5Tclose(color);
    H5Tclose(text);
    return type;
}

// ---- writing ----------------------------------------------------------------------------------

static bool write_attribute(asset_file *file, hid_t owner, const char *name, hid_t stored,
                            hid_t given, uint32_t length, const void *values) {
    const hsize_t size = length;
    const hid_t space = length == 1 ? H5Screate(H5S_SCALAR) : H5Screate_simple(1, &size, NULL);
    const hid_t attribute = H5Acreate2(owner, name, stored, space, H5P_DEFAULT, H5P_DEFAULT);
    const bool good =
        (attribute >= 0 && H5Awrite(attribute, given, values) >= 0) || hdf5_failed(file, name);
    H5Aclose(attribute);
    H5Sclose(space);
    return good;
}

static bool write_numbers(asset_file *file, hid_t owner, const char *name, pci_element element,
                          uint32_t length, const void *values) {
    return write_attribute(file, owner, name, file_type(element), memory_type(element), length,
                           values);
}

static bool write_text(asset_file *file, hid_t owner, const char *name, const char *text) {
    const hid_t type = text_type(strlen(text) + 1);
    const bool good = write_attribute(file, owner, name, type, type, 1, text);
    H5Tclose(type);
    return good;
}

// A group whose attributes and links live in its header: smaller, and the same bytes every time.
static hid_t create_group(asset_file *file, hid_t parent, const char *name) {
    const hid_t properties = H5Pcreate(H5P_GROUP_CREATE);
    hid_t group = H5I_INVALID_HID;
    if (H5Pset_obj_track_times(properties, 0) >= 0 &&
        H5Pset_link_phase_change(properties, 64, 0) >= 0 &&
        H5Pset_attr_phase_change(properties, 64, 0) >= 0) {
        group = H5Gcreate2(parent, name, H5P_DEFAULT, properties, H5P_DEFAULT);
    }
    if (group < 0) {
        hdf5_failed(file, name);
    }
    H5Pclose(properties);
    return group;
}

static bool write_record(asset_file *file, hid_t parent, const char *name, const pc_record *record,
                         const void *values) {
    const hid_t group = create_group(file, parent, name);
    bool good = group >= 0;
    for (size_t i = 0; i < record->field_count && good; ++i) {
        const pc_field *field = &record->fields[i];
        const char *at = (const char *)values + field->offset;
        if (field->type == PC_FIELD_CHOICE) {
            const uint32_t choice = *(const uint32_t *)(const void *)at;
            uint32_t known = 0;
            while (known < choice && field->choices[known] != NULL) {
                ++known;
            }
            if (field->choices[known] == NULL) {
                file->status = pci_fail(file->context, PC_ERROR_INVALID_ARGUMENT, STAGE,
                                        STAGE ": %s = %u is no choice", field->name, choice);
                good = false;
            } else {
                good = write_text(file, group, field->name, field->choices[choice]);
            }
        } else {
            good = write_numbers(file, group, field->name, field_element(field), 1, at);
        }
    }
    H5Gclose(group);
    return good;
}

static bool write_dataset(asset_file *file, hid_t parent, const char *name, hid_t stored,
                          hid_t given, const size_t *shape, size_t rank, const void *values) {
    hsize_t dimensions[3];
    size_t count = 1;
    for (size_t k = 0; k < rank; ++k) {
        dimensions[k] = shape[k];
        count *= shape[k];
    }
    const hid_t properties = H5Pcreate(H5P_DATASET_CREATE);
    const hid_t space = H5Screate_simple((int)rank, dimensions, NULL);
    hid_t dataset = H5I_INVALID_HID;
    if (H5Pset_obj_track_times(properties, 0) >= 0) {
        dataset = H5Dcreate2(parent, name, stored, space, H5P_DEFAULT, properties, H5P_DEFAULT);
    }
    const bool good = (dataset >= 0 && (count == 0 || H5Dwrite(dataset, given, H5S_ALL, H5S_ALL,
                                                               H5P_DEFAULT, values) >= 0)) ||
                      hdf5_failed(file, name);
    H5Dclose(dataset);
    H5Sclose(space);
    H5Pclose(properties);
    return good;
}

static bool write_materials(asset_file *file, hid_t group, const pc_visual *visual) {
    const size_t count = visual->material_count;
    stored_material *rows = PCI_ALLOCATE(file->context, stored_material, count);
    if (rows == NULL) {
        return out_of_memory(file);
    }
    for (size_t i = 0; i < count; ++i) {
        const pc_material *material = &visual->materials[i];
        // Bytes behind the end of the name do not matter and must not differ.
        memcpy(rows[i].name, material->name, strlen(material->name));
        memcpy(rows[i].base_color, material->base_color, sizeof(rows[i].base_color));
        rows[i].metallic = material->metallic;
        rows[i].roughness = material->roughness;
        rows[i].double_sided = material->double_sided;
    }
    const hid_t stored = material_type(true), given = material_type(false);
    const bool good = write_dataset(file, group, "materials", stored, given, &count, 1, rows);
    H5Tclose(given);
    H5Tclose(stored);
    pc_release(file->context, rows);
    return good;
}

// The scenario as its text; nothing for the paper's.
static bool write_scenario(asset_file *file, hid_t group, const pc_scenario *scenario) {
    if (scenario->wind_count == 0 && scenario->pin_count == 0 && scenario->collider_count == 0 &&
        scenario->attachment.kind == PC_ATTACHMENT_NONE) {
        return true;
    }
    char *text = pci_scenario_text(file->context, scenario);
    if (text == NULL) {
        return out_of_memory(file);
    }
    const size_t size = strlen(text);
    const bool good =
        write_dataset(file, group, "scenario", H5T_STD_U8LE, H5T_NATIVE_UINT8, &size, 1, text);
    pc_release(file->context, text);
    return good;
}

static bool write_group(asset_file *file, const pc_asset *asset, int group) {
    const hid_t id = create_group(file, file->id, pci_group_name(group));
    bool good = id >= 0;
    for (size_t i = 0; i < pci_scalar_count && good; ++i) {
        const pci_scalar_info *info = &pci_scalars[i];
        if (info->group == group) {
            good = write_numbers(file, id, info->name, info->element, info->length,
                                 (const char *)asset + info->offset);
        }
    }
    for (size_t i = 0; i < pci_array_count && good; ++i) {
        const pci_array_info *info = &pci_arrays[i];
        const void *values = pci_array_get(asset, info);
        size_t shape[3];
        const size_t rank = pci_array_shape(asset, info, shape);
        if (info->group == group && (values != NULL || !info->optional)) {
            good = write_dataset(file, id, info->name, file_type(info->element),
                                 memory_type(info->element), shape, rank, values);
        }
    }
    if (group == 0) {
        good = good && write_materials(file, id, &asset->visual) &&
               write_record(file, id, "report", &pc_visual_report_record, &asset->reports.visual);
    } else {
        const pc_stage_info *info = pc_stage_describe((pc_stage)(group - 1));
        good = good &&
               write_record(file, id, "options", info->options,
                            (const char *)&asset->options + info->options_offset) &&
               write_record(file, id, "report", info->report,
                            (const char *)&asset->reports + info->report_offset) &&
               (group != PC_STAGE_SIMULATE + 1 || write_scenario(file, id, &asset->scenario));
    }
    H5Gclose(id);
    return good;
}

// HDF5 tells files in memory apart by name; the name is not stored.
static hid_t memory_file_access(const asset_file *file, char name[32]) {
    snprintf(name, 32, "%p", (const void *)file);
    const hid_t access = H5Pcreate(H5P_FILE_ACCESS);
    if (access >= 0 && (H5Pset_fapl_core(access, (size_t)1 << 20, 0) < 0 ||
                        H5Pset_libver_bounds(access, H5F_LIBVER_V110, H5F_LIBVER_V110) < 0)) {
        H5Pclose(access);
        return H5I_INVALID_HID;
    }
    return access;
}

// Memory of the file that is being written. When it is closed its memory comes to us. The image
// that H5Fget_file_image makes of an open file has a wrong checksum (HDF5 1.10.8).
typedef struct closed_image {
    unsigned char *bytes; // from malloc
} closed_image;

static void *image_allocate(size_t size, H5FD_file_image_op_t operation, void *user) {
    (void)operation;
    (void)user;
    return malloc(size);
}
static void *image_copy(void *target, const void *source, size_t size,
                        H5FD_file_image_op_t operation, void *user) {
    (void)operation;
    (void)user;
    return memcpy(target, source, size);
}
static void *image_resize(void *memory, size_t size, H5FD_file_image_op_t operation, void *user) {
    (void)operation;
    (void)user;
    return realloc(memory, size);
}
static herr_t image_release(void *memory, H5FD_file_image_op_t operation, void *user) {
    if (operation == H5FD_FILE_IMAGE_OP_FILE_CLOSE) {
        ((closed_image *)user)->bytes = memory;
    } else {
        free(memory);
    }
    return 0;
}
static void *image_share_user(void *user) { return user; }
static herr_t image_forget_user(void *user) {
    (void)user;
    return 0;
}

static bool create_file(asset_file *file, closed_image *image) {
    char name[32];
    H5FD_file_image_callbacks_t callbacks = {image_allocate, image_copy,       image_resize,
                                             image_release,  image_share_user, image_forget_user,
                                             image};
    const hid_t access = memory_file_access(file, name);
    const hid_t creation = H5Pcreate(H5P_FILE_CREATE);
    if (access >= 0 && H5Pset_file_image_callbacks(access, &callbacks) >= 0 &&
        H5Pset_obj_track_times(creation, 0) >= 0) {
        file->id = H5Fcreate(name, H5F_ACC_TRUNC, creation, access);
    }
    const bool good = file->id >= 0 || hdf5_failed(file, "/");
    H5Pclose(creation);
    H5Pclose(access);
    return good;
}

static bool write_asset(asset_file *file, const pc_asset *asset, closed_image *image) {
    const uint32_t version = PC_ASSET_FORMAT_VERSION;
    bool good =
        create_file(file, image) && write_text(file, file->id, "format", FORMAT_TEXT) &&
        write_numbers(file, file->id, "format_version", PCI_ELEMENT_U32, 1, &version) &&
        write_text(file, file->id, "library_version", PC_VERSION_STRING) &&
        write_text(file, file->id, "name", asset->name) &&
        write_numbers(file, file->id, "stage_count", PCI_ELEMENT_U32, 1, &asset->stage_count);
    for (int group = 0; group <= (int)asset->stage_count && good; ++group) {
        good = write_group(file, asset, group);
    }
    return good;
}

// The superblock says where the file ends.
static uint64_t end_of_file(const unsigned char *bytes) {
    uint64_t end = 0;
    for (size_t i = 0; i < 8; ++i) {
        end |= (uint64_t)bytes[28 + i] << (8 * i);
    }
    return end;
}

static void write_image(asset_file *file, const closed_image *image) {
    if (image->bytes == NULL) {
        file->status = pci_fail_memory(file->context, STAGE);
        return;
    }
    const size_t size = end_of_file(image->bytes);
    unsigned char seal[SEAL_SIZE];
    make_seal(image->bytes, size, seal);
    pci_atomic_file output = {0};
    file->status = pci_atomic_begin(file->context, STAGE, file->path, &output);
    if (file->status == PC_OK) {
        fwrite(image->bytes, 1, size, output.stream);
        fwrite(seal, 1, sizeof(seal), output.stream);
        file->status = pci_atomic_end(&output, PC_OK);
    }
}

pc_status pc_asset_save(pc_context *context, const pc_asset *asset, const char *path) {
    if (context == NULL) {
        return PC_ERROR_INVALID_ARGUMENT;
    }
    if (asset == NULL || path == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, STAGE, STAGE ": a pointer is NULL");
    }
    char problem[256];
    if (!pci_asset_check(asset, problem, sizeof(problem))) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, STAGE,
                        STAGE ": the asset cannot be saved: %s", problem);
    }
    const pc_status checked = asset->stage_count > PC_STAGE_SIMULATE
                                  ? pc_scenario_check(context, &asset->scenario)
                                  : PC_OK;
    if (checked == PC_ERROR_INVALID_OPTIONS) {
        snprintf(problem, sizeof(problem), "%.255s", pc_context_error(context)->message);
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, STAGE,
                        STAGE ": the asset cannot be saved: %s", problem);
    }
    if (checked != PC_OK) {
        return checked;
    }
    asset_file file = {.context = context, .path = path, .id = H5I_INVALID_HID};
    closed_image image = {NULL};
    silence_hdf5(&file);
    const bool written = write_asset(&file, asset, &image);
    if (H5Fclose(file.id) < 0 && written) {
        hdf5_failed(&file, "/");
    }
    restore_hdf5(&file);
    if (file.status == PC_OK) {
        write_image(&file, &image);
    }
    free(image.bytes);
    return file.status;
}

// ---- reading ----------------------------------------------------------------------------------

// Whether the attribute is there and has the expected type and length.
static bool read_attribute(asset_file *file, hid_t owner, const char *name, hid_t stored,
                           hid_t wanted, uint32_t length, void *values) {
    const hid_t attribute = H5Aopen(owner, name, H5P_DEFAULT);
    const hid_t type = H5Aget_type(attribute);
    const hid_t space = H5Aget_space(attribute);
    hsize_t size = 1;
    bool good = false;
    if (attribute < 0 || type < 0 || space < 0) {
        hdf5_failed(file, name);
    } else if (H5Tequal(type, stored) <= 0 ||
               H5Sget_simple_extent_ndims(space) != (length == 1 ? 0 : 1) ||
               H5Sget_simple_extent_dims(space, &size, NULL) < 0 ||
               H5Sget_simple_extent_npoints(space) != (hssize_t)length) {
        damaged(file, name, "has another type");
    } else {
        good = H5Aread(attribute, wanted, values) >= 0 || hdf5_failed(file, name);
    }
    H5Sclose(space);
    H5Tclose(type);
    H5Aclose(attribute);
    return good;
}

static bool read_numbers(asset_file *file, hid_t owner, const char *name, pci_element element,
                         uint32_t length, void *values) {
    return read_attribute(file, owner, name, file_type(element), memory_type(element), length,
                          values);
}

// A text of at most TEXT_LIMIT bytes with its end.
static bool read_text(asset_file *file, hid_t owner, const char *name, char text[TEXT_LIMIT]) {
    memset(text, 0, TEXT_LIMIT);
    const hid_t attribute = H5Aopen(owner, name, H5P_DEFAULT);
    const hid_t type = H5Aget_type(attribute);
    const size_t size = H5Tget_size(type);
    const bool expected = H5Tget_class(type) == H5T_STRING && H5Tis_variable_str(type) == 0 &&
                          size >= 1 && size <= TEXT_LIMIT;
    H5Tclose(type);
    H5Aclose(attribute);
    if (!expected) {
        return damaged(file, name, "is not a text");
    }
    const hid_t wanted = text_type(size);
    const bool good = read_attribute(file, owner, name, wanted, wanted, 1, text);
    H5Tclose(wanted);
    return good && (text[size - 1] == '\0' || damaged(file, name, "does not end"));
}

static bool has_attribute(hid_t owner, const char *name) { return H5Aexists(owner, name) > 0; }

// Only objects of this very file: a link could lead to any file of the reader's disk.
static bool has_object(hid_t parent, const char *name) {
    H5L_info_t info;
    return H5Lexists(parent, name, H5P_DEFAULT) > 0 &&
           H5Lget_info(parent, name, &info, H5P_DEFAULT) >= 0 && info.type == H5L_TYPE_HARD;
}

static hid_t open_group(asset_file *file, hid_t parent, const char *name) {
    if (!has_object(parent, name)) {
        damaged(file, name, "is missing");
        return H5I_INVALID_HID;
    }
    const hid_t group = H5Gopen2(parent, name, H5P_DEFAULT);
    if (group < 0) {
        hdf5_failed(file, name);
    }
    return group;
}

static bool read_choice(asset_file *file, hid_t group, const pc_field *field, uint32_t *choice) {
    char text[TEXT_LIMIT];
    if (!read_text(file, group, field->name, text)) {
        return false;
    }
    for (uint32_t i = 0; field->choices[i] != NULL; ++i) {
        if (strcmp(field->choices[i], text) == 0) {
            *choice = i;
            return true;
        }
    }
    return damaged(file, field->name, "has an unknown choice");
}

// Fields that the file lacks, because an older library wrote it, keep what `values` holds.
static bool read_record(asset_file *file, hid_t parent, const char *name, const pc_record *record,
                        void *values) {
    const hid_t group = open_group(file, parent, name);
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
                   (flag <= 1 || damaged(file, field->name, "is neither 0 nor 1"));
            *(bool *)at = good && flag != 0;
        } else {
            good = read_numbers(file, group, field->name, field_element(field), 1, at);
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
static bool read_shape(asset_file *file, hid_t dataset, const char *name, hid_t stored, size_t rank,
                       size_t shape[3]) {
    const hid_t type = H5Dget_type(dataset);
    const hid_t space = H5Dget_space(dataset);
    hsize_t dimensions[3] = {0};
    bool good = H5Tequal(type, stored) > 0 && H5Sget_simple_extent_ndims(space) == (int)rank &&
                H5Sget_simple_extent_dims(space, dimensions, NULL) == (int)rank;
    if (!good) {
        damaged(file, name, "has another type or shape");
    } else if (!is_plain(dataset)) {
        good = damaged(file, name, "is packed or lies outside of the file");
    } else {
        size_t bytes = H5Tget_size(stored);
        for (size_t k = 0; k < rank && good; ++k) {
            shape[k] = (size_t)dimensions[k];
            good = dimensions[k] <= INT32_MAX &&
                   (dimensions[k] == 0 || bytes <= file->image_size / dimensions[k]);
            bytes *= shape[k];
        }
        good = (good && H5Dget_storage_size(dataset) >= bytes) ||
               damaged(file, name, "is larger than the file");
    }
    H5Sclose(space);
    H5Tclose(type);
    return good;
}

static hid_t open_dataset(asset_file *file, hid_t parent, const char *name) {
    if (!has_object(parent, name)) {
        damaged(file, name, "is missing");
        return H5I_INVALID_HID;
    }
    const hid_t dataset = H5Dopen2(parent, name, H5P_DEFAULT);
    if (dataset < 0) {
        hdf5_failed(file, name);
    }
    return dataset;
}

// Memory for the rows of a dataset, filled; NULL on failure.
static void *read_rows(asset_file *file, hid_t dataset, const char *name, hid_t wanted,
                       size_t count) {
    void *rows = pci_allocate(file->context, count, H5Tget_size(wanted));
    if (rows == NULL) {
        out_of_memory(file);
    } else if (count > 0 && H5Dread(dataset, wanted, H5S_ALL, H5S_ALL, H5P_DEFAULT, rows) < 0) {
        hdf5_failed(file, name);
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

static bool read_array(asset_file *file, hid_t group, const pci_array_info *info, pc_asset *asset,
                       bool known[PCI_COUNT_COUNT]) {
    if (info->optional && !has_object(group, info->name)) {
        return true;
    }
    const size_t rank = 1u + (info->columns != PCI_COUNT_NONE) + (info->tuple != 1);
    size_t shape[3] = {1, 1, 1};
    const hid_t dataset = open_dataset(file, group, info->name);
    bool good = dataset >= 0 &&
                read_shape(file, dataset, info->name, file_type(info->element), rank, shape);
    if (good && !agree_on_counts(asset, info, shape, known)) {
        good = damaged(file, info->name, "has another number of elements than its neighbours");
    }
    if (good) {
        void *array = read_rows(file, dataset, info->name, memory_type(info->element),
                                shape[0] * shape[1] * shape[2]);
        pci_array_set(asset, info, array);
        good = array != NULL;
    }
    H5Dclose(dataset);
    return good;
}

static bool read_materials(asset_file *file, hid_t group, pc_visual *visual) {
    const hid_t stored = material_type(true), wanted = material_type(false);
    const hid_t dataset = open_dataset(file, group, "materials");
    size_t count[3] = {0};
    stored_material *rows = NULL;
    bool good = dataset >= 0 && read_shape(file, dataset, "materials", stored, 1, count);
    if (good) {
        rows = read_rows(file, dataset, "materials", wanted, count[0]);
        good = rows != NULL;
    }
    if (good) {
        visual->materials = PCI_ALLOCATE(file->context, pc_material, count[0]);
        visual->material_count = count[0];
        good = visual->materials != NULL || out_of_memory(file);
    }
    for (size_t i = 0; i < count[0] && good; ++i) {
        pc_material *material = &visual->materials[i];
        memcpy(material->name, rows[i].name, sizeof(material->name));
        memcpy(material->base_color, rows[i].base_color, sizeof(material->base_color));
        material->metallic = rows[i].metallic;
        material->roughness = rows[i].roughness;
        material->double_sided = rows[i].double_sided != 0;
        good = rows[i].double_sided <= 1 || damaged(file, "materials", "has a bad flag");
    }
    pc_release(file->context, rows);
    H5Dclose(dataset);
    H5Tclose(wanted);
    H5Tclose(stored);
    return good;
}

static bool read_scenario(asset_file *file, hid_t group, pc_scenario *scenario) {
    if (!has_object(group, "scenario")) {
        return true;
    }
    size_t shape[3] = {0};
    char *text = NULL;
    const hid_t dataset = open_dataset(file, group, "scenario");
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
        good = status == PC_OK ||
               (status == PC_ERROR_OUT_OF_MEMORY ? out_of_memory(file)
                                                 : damaged(file, "scenario", "is no scenario"));
    }
    pc_release(file->context, text);
    H5Dclose(dataset);
    return good;
}

static bool read_group(asset_file *file, pc_asset *asset, int group) {
    bool known[PCI_COUNT_COUNT] = {false};
    known[PCI_COUNT_MATERIALS] = group == 0;
    const hid_t id = open_group(file, file->id, pci_group_name(group));
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

static bool other_kind(asset_file *file, const char *what) {
    file->status = pci_fail(file->context, PC_ERROR_FORMAT, STAGE,
                            STAGE ": \"%.300s\" is no asset file: %s", file->path, what);
    return false;
}

static bool open_file(asset_file *file, unsigned char *image) {
    static const unsigned char signature[] = {0x89, 'H', 'D', 'F', '\r', '\n', 0x1a, '\n'};
    if (file->image_size < 48 + SEAL_SIZE || memcmp(image, signature, sizeof(signature)) != 0) {
        return other_kind(file, "it is not HDF5");
    }
    file->image_size -= SEAL_SIZE;
    const unsigned char *seal = image + file->image_size;
    if (memcmp(seal, seal_mark, sizeof(seal_mark)) != 0) {
        return other_kind(file, "it is HDF5 of another kind, was cut off, or was changed by "
                                "another program");
    }
    unsigned char expected[SEAL_SIZE];
    make_seal(image, file->image_size, expected);
    if (memcmp(seal, expected, SEAL_SIZE) != 0) {
        return damaged(file, "its checksum", "is wrong");
    }
    char name[32];
    const hid_t access = memory_file_access(file, name);
    if (access >= 0 && H5Pset_file_image(access, image, file->image_size) >= 0) {
        file->id = H5Fopen(name, H5F_ACC_RDONLY, access);
    }
    const bool good = file->id >= 0 || hdf5_failed(file, "/");
    H5Pclose(access);
    return good;
}

static bool read_header(asset_file *file, pc_asset *asset) {
    char text[TEXT_LIMIT];
    uint32_t version = 0;
    if (!has_attribute(file->id, "format") || !read_text(file, file->id, "format", text) ||
        strcmp(text, FORMAT_TEXT) != 0) {
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
        return damaged(file, "format_version", "is 0");
    }
    if (!read_text(file, file->id, "name", text) ||
        !read_numbers(file, file->id, "stage_count", PCI_ELEMENT_U32, 1, &asset->stage_count)) {
        return false;
    }
    memcpy(asset->name, text, sizeof(asset->name));
    return asset->stage_count <= PC_STAGE_COUNT || damaged(file, "stage_count", "is out of range");
}

static bool read_asset(asset_file *file, pc_asset *asset) {
    bool good = read_header(file, asset);
    for (int group = 0; good && group <= (int)asset->stage_count; ++group) {
        good = read_group(file, asset, group);
    }
    char problem[256];
    if (good && !pci_asset_check(asset, problem, sizeof(problem))) {
        good = damaged(file, problem, "");
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
    asset_file file = {.context = context, .path = path, .id = H5I_INVALID_HID};
    unsigned char *image = NULL;
    file.status = pci_read_file(context, STAGE, path, &image, &file.image_size);
    if (file.status != PC_OK) {
        return file.status;
    }
    silence_hdf5(&file);
    const bool opened = open_file(&file, image);
    pc_release(context, image);
    if (!opened || !read_asset(&file, asset)) {
        pc_asset_free(context, asset);
    }
    H5Fclose(file.id);
    restore_hdf5(&file);
    return file.status;
}
