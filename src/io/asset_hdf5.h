// Asset files as HDF5: what saving (asset_save.c) and loading (asset_load.c) share. HDF5 works on
// images in memory only, so that reading and writing the disk, with its error messages and the
// renaming of finished files, is the same as for every other format.
#ifndef PCI_ASSET_HDF5_H
#define PCI_ASSET_HDF5_H

#include <hdf5.h>

#include "io/asset_table.h"
#include "proxycloth/asset_file.h"

#define PCI_ASSET_STAGE "asset"
#define PCI_FORMAT_TEXT "proxycloth asset"
#define PCI_TEXT_LIMIT  128

// The last bytes of every asset file, behind what HDF5 uses: a mark and the hash of all bytes
// before the seal. Damage is found before HDF5 1.10 sees it, which loses memory over some of it and
// prints when the process ends.
#define PCI_SEAL_SIZE 16
extern const unsigned char pci_seal_mark[8];
void pci_asset_make_seal(const unsigned char *bytes, size_t size,
                         unsigned char seal[PCI_SEAL_SIZE]);

// What one save or load call holds. The first failure is kept; every function that takes one
// returns false from then on.
typedef struct pci_asset_file {
    pc_context *context;
    const char *path;
    hid_t id;
    size_t image_size; // when reading
    pc_status status;
    H5E_auto2_t error_function; // of the caller, while ours is none
    void *error_data;
} pci_asset_file;

void pci_asset_silence_hdf5(pci_asset_file *file);
void pci_asset_restore_hdf5(pci_asset_file *file);

// All three return false. A call to HDF5 failed: when reading, the file is to blame.
bool pci_asset_hdf5_failed(pci_asset_file *file, const char *object);
bool pci_asset_damaged(pci_asset_file *file, const char *object, const char *problem);
bool pci_asset_out_of_memory(pci_asset_file *file);

// Types in the file are little-endian, whatever the machine is.
hid_t pci_asset_file_type(pci_element element);
hid_t pci_asset_memory_type(pci_element element);
hid_t pci_asset_text_type(size_t size);
// How a field of a record is stored; choices are stored by name.
pci_element pci_asset_field_element(const pc_field *field);

// A material as a row of a table; pc_material has a bool, which not every byte is.
typedef struct pci_stored_material {
    char name[sizeof(((pc_material *)0)->name)];
    float base_color[4];
    float metallic;
    float roughness;
    uint8_t double_sided;
} pci_stored_material;

// The row's type in memory, or packed and little-endian in the file.
hid_t pci_asset_material_type(bool in_file);

// Access to a file in memory. HDF5 tells such files apart by `name`, which is set; it is not
// stored.
hid_t pci_asset_memory_file_access(const pci_asset_file *file, char name[32]);

#endif
