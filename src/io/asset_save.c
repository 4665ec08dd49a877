// An asset -> an asset file.
#include <stdio.h>
#include <stdlib.h>

#include "io/asset_hdf5.h"
#include "io/atomic_file.h"
#include "io/scenario_file.h"
#include "proxycloth/version.h"

#define STAGE PCI_ASSET_STAGE

static bool write_attribute(pci_asset_file *file, hid_t owner, const char *name, hid_t stored,
                            hid_t given, uint32_t length, const void *values) {
    const hsize_t size = length;
    const hid_t space = length == 1 ? H5Screate(H5S_SCALAR) : H5Screate_simple(1, &size, NULL);
    const hid_t attribute = H5Acreate2(owner, name, stored, space, H5P_DEFAULT, H5P_DEFAULT);
    const bool good = (attribute >= 0 && H5Awrite(attribute, given, values) >= 0) ||
                      pci_asset_hdf5_failed(file, name);
    H5Aclose(attribute);
    H5Sclose(space);
    return good;
}

static bool write_numbers(pci_asset_file *file, hid_t owner, const char *name, pci_element element,
                          uint32_t length, const void *values) {
    return write_attribute(file, owner, name, pci_asset_file_type(element),
                           pci_asset_memory_type(element), length, values);
}

static bool write_text(pci_asset_file *file, hid_t owner, const char *name, const char *text) {
    const hid_t type = pci_asset_text_type(strlen(text) + 1);
    const bool good = write_attribute(file, owner, name, type, type, 1, text);
    H5Tclose(type);
    return good;
}

// A group whose attributes and links live in its header: smaller, and the same bytes every time.
static hid_t create_group(pci_asset_file *file, hid_t parent, const char *name) {
    const hid_t properties = H5Pcreate(H5P_GROUP_CREATE);
    hid_t group = H5I_INVALID_HID;
    if (H5Pset_obj_track_times(properties, 0) >= 0 &&
        H5Pset_link_phase_change(properties, 64, 0) >= 0 &&
        H5Pset_attr_phase_change(properties, 64, 0) >= 0) {
        group = H5Gcreate2(parent, name, H5P_DEFAULT, properties, H5P_DEFAULT);
    }
    if (group < 0) {
        pci_asset_hdf5_failed(file, name);
    }
    H5Pclose(properties);
    return group;
}

static bool write_record(pci_asset_file *file, hid_t parent, const char *name,
                         const pc_record *record, const void *values) {
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
            good = write_numbers(file, group, field->name, pci_asset_field_element(field), 1, at);
        }
    }
    H5Gclose(group);
    return good;
}

static bool write_dataset(pci_asset_file *file, hid_t parent, const char *name, hid_t stored,
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
                      pci_asset_hdf5_failed(file, name);
    H5Dclose(dataset);
    H5Sclose(space);
    H5Pclose(properties);
    return good;
}

static bool write_materials(pci_asset_file *file, hid_t group, const pc_visual *visual) {
    const size_t count = visual->material_count;
    pci_stored_material *rows = PCI_ALLOCATE(file->context, pci_stored_material, count);
    if (rows == NULL) {
        return pci_asset_out_of_memory(file);
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
    const hid_t stored = pci_asset_material_type(true), given = pci_asset_material_type(false);
    const bool good = write_dataset(file, group, "materials", stored, given, &count, 1, rows);
    H5Tclose(given);
    H5Tclose(stored);
    pc_release(file->context, rows);
    return good;
}

// The scenario as its text; nothing for the paper's.
static bool write_scenario(pci_asset_file *file, hid_t group, const pc_scenario *scenario) {
    if (scenario->wind_count == 0 && scenario->pin_count == 0 && scenario->collider_count == 0 &&
        scenario->attachment.kind == PC_ATTACHMENT_NONE) {
        return true;
    }
    char *text = pci_scenario_text(file->context, scenario);
    if (text == NULL) {
        return pci_asset_out_of_memory(file);
    }
    const size_t size = strlen(text);
    const bool good =
        write_dataset(file, group, "scenario", H5T_STD_U8LE, H5T_NATIVE_UINT8, &size, 1, text);
    pc_release(file->context, text);
    return good;
}

static bool write_group(pci_asset_file *file, const pc_asset *asset, int group) {
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
            good = write_dataset(file, id, info->name, pci_asset_file_type(info->element),
                                 pci_asset_memory_type(info->element), shape, rank, values);
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

static bool create_file(pci_asset_file *file, closed_image *image) {
    char name[32];
    H5FD_file_image_callbacks_t callbacks = {image_allocate, image_copy,       image_resize,
                                             image_release,  image_share_user, image_forget_user,
                                             image};
    const hid_t access = pci_asset_memory_file_access(file, name);
    const hid_t creation = H5Pcreate(H5P_FILE_CREATE);
    if (access >= 0 && H5Pset_file_image_callbacks(access, &callbacks) >= 0 &&
        H5Pset_obj_track_times(creation, 0) >= 0) {
        file->id = H5Fcreate(name, H5F_ACC_TRUNC, creation, access);
    }
    const bool good = file->id >= 0 || pci_asset_hdf5_failed(file, "/");
    H5Pclose(creation);
    H5Pclose(access);
    return good;
}

static bool write_asset(pci_asset_file *file, const pc_asset *asset, closed_image *image) {
    const uint32_t version = PC_ASSET_FORMAT_VERSION;
    bool good =
        create_file(file, image) && write_text(file, file->id, "format", PCI_FORMAT_TEXT) &&
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

typedef struct image_job {
    const unsigned char *bytes;
    size_t size;
    unsigned char seal[PCI_SEAL_SIZE];
    FILE *stream;
} image_job;

// Hashing and writing take about as long.
static void seal_or_write(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    image_job *job = user;
    if (begin == 0) {
        pci_asset_make_seal(job->bytes, job->size, job->seal);
    }
    if (end == 2) {
        fwrite(job->bytes, 1, job->size, job->stream);
    }
}

static void write_image(pci_asset_file *file, const closed_image *image) {
    if (image->bytes == NULL) {
        file->status = pci_fail_memory(file->context, STAGE);
        return;
    }
    pci_atomic_file output = {0};
    file->status = pci_atomic_begin(file->context, STAGE, file->path, &output);
    if (file->status == PC_OK) {
        image_job job = {
            .bytes = image->bytes, .size = end_of_file(image->bytes), .stream = output.stream};
        pci_parallel_for(file->context, 2, 1, seal_or_write, &job);
        fwrite(job.seal, 1, sizeof(job.seal), output.stream);
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
    pci_asset_file file = {.context = context, .path = path, .id = H5I_INVALID_HID};
    closed_image image = {NULL};
    pci_asset_silence_hdf5(&file);
    const bool written = write_asset(&file, asset, &image);
    if (H5Fclose(file.id) < 0 && written) {
        pci_asset_hdf5_failed(&file, "/");
    }
    pci_asset_restore_hdf5(&file);
    if (file.status == PC_OK) {
        write_image(&file, &image);
    }
    free(image.bytes);
    return file.status;
}
