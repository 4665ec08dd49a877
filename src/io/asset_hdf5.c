// What saving and loading of asset files share: errors, types, the seal.
#include "io/asset_hdf5.h"

#include <stdio.h>

const unsigned char pci_seal_mark[8] = {'p', 'c', '-', 'a', 's', 's', 'e', 't'};

// FNV-1a.
void pci_asset_make_seal(const unsigned char *bytes, size_t size,
                         unsigned char seal[PCI_SEAL_SIZE]) {
    uint64_t hash = 0xcbf29ce484222325u;
    for (size_t i = 0; i < size; ++i) {
        hash = (hash ^ bytes[i]) * 0x100000001b3u;
    }
    memcpy(seal, pci_seal_mark, sizeof(pci_seal_mark));
    for (size_t i = 0; i < 8; ++i) {
        seal[8 + i] = (unsigned char)(hash >> (8 * i));
    }
}

void pci_asset_silence_hdf5(pci_asset_file *file) {
    H5Eget_auto2(H5E_DEFAULT, &file->error_function, &file->error_data);
    H5Eset_auto2(H5E_DEFAULT, NULL, NULL);
}

void pci_asset_restore_hdf5(pci_asset_file *file) {
    H5Eclear2(H5E_DEFAULT);
    H5Eset_auto2(H5E_DEFAULT, file->error_function, file->error_data);
}

static herr_t keep_first_cause(unsigned index, const H5E_error2_t *error, void *user) {
    if (index == 0 && error->desc != NULL) {
        snprintf(user, PCI_TEXT_LIMIT, "%s", error->desc);
    }
    return 0;
}

bool pci_asset_hdf5_failed(pci_asset_file *file, const char *object) {
    char cause[PCI_TEXT_LIMIT] = "no reason given";
    H5Ewalk2(H5E_DEFAULT, H5E_WALK_UPWARD, keep_first_cause, cause);
    if (file->status == PC_OK) {
        file->status =
            file->image_size != 0
                ? pci_fail(file->context, PC_ERROR_FORMAT, PCI_ASSET_STAGE,
                           PCI_ASSET_STAGE ": \"%.200s\" is damaged at %.100s (HDF5: %s)",
                           file->path, object, cause)
                : pci_fail(file->context, PC_ERROR_DEPENDENCY, PCI_ASSET_STAGE,
                           PCI_ASSET_STAGE ": HDF5 cannot write %.100s: %s", object, cause);
    }
    return false;
}

bool pci_asset_damaged(pci_asset_file *file, const char *object, const char *problem) {
    if (file->status == PC_OK) {
        file->status = pci_fail(file->context, PC_ERROR_FORMAT, PCI_ASSET_STAGE,
                                PCI_ASSET_STAGE ": \"%.200s\" is damaged: %.100s %s", file->path,
                                object, problem);
    }
    return false;
}

bool pci_asset_out_of_memory(pci_asset_file *file) {
    if (file->status == PC_OK) {
        file->status = pci_fail_memory(file->context, PCI_ASSET_STAGE);
    }
    return false;
}

hid_t pci_asset_file_type(pci_element element) {
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

hid_t pci_asset_memory_type(pci_element element) {
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

hid_t pci_asset_text_type(size_t size) {
    const hid_t type = H5Tcopy(H5T_C_S1);
    if (type >= 0 && (H5Tset_size(type, size) < 0 || H5Tset_cset(type, H5T_CSET_UTF8) < 0)) {
        H5Tclose(type);
        return H5I_INVALID_HID;
    }
    return type;
}

pci_element pci_asset_field_element(const pc_field *field) {
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

hid_t pci_asset_material_type(bool in_file) {
    static const hsize_t four = 4;
    const hid_t real = in_file ? H5T_IEEE_F32LE : H5T_NATIVE_FLOAT;
    const hid_t flag = in_file ? H5T_STD_U8LE : H5T_NATIVE_UINT8;
    const hid_t text = pci_asset_text_type(sizeof(((pci_stored_material *)0)->name));
    const hid_t color = H5Tarray_create2(real, 1, &four);
    hid_t type = H5Tcreate(H5T_COMPOUND, sizeof(pci_stored_material));
    if (H5Tinsert(type, "name", HOFFSET(pci_stored_material, name), text) < 0 ||
        H5Tinsert(type, "base_color", HOFFSET(pci_stored_material, base_color), color) < 0 ||
        H5Tinsert(type, "metallic", HOFFSET(pci_stored_material, metallic), real) < 0 ||
        H5Tinsert(type, "roughness", HOFFSET(pci_stored_material, roughness), real) < 0 ||
        H5Tinsert(type, "double_sided", HOFFSET(pci_stored_material, double_sided), flag) < 0 ||
        (in_file && H5Tpack(type) < 0)) {
        H5Tclose(type);
        type = H5I_INVALID_HID;
    }
    H5Tclose(color);
    H5Tclose(text);
    return type;
}

hid_t pci_asset_memory_file_access(const pci_asset_file *file, char name[32]) {
    snprintf(name, 32, "%p", (const void *)file);
    const hid_t access = H5Pcreate(H5P_FILE_ACCESS);
    if (access >= 0 && (H5Pset_fapl_core(access, (size_t)1 << 20, 0) < 0 ||
                        H5Pset_libver_bounds(access, H5F_LIBVER_V110, H5F_LIBVER_V110) < 0)) {
        H5Pclose(access);
        return H5I_INVALID_HID;
    }
    return access;
}
