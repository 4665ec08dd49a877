// Files without a name, of which nothing stays behind when the process ends; Linux has them on most
// file systems.
#ifndef PCI_NAMELESS_FILE_H
#define PCI_NAMELESS_FILE_H

// Opens one for writing on the file system of a folder. Returns its descriptor, or -1.
int pci_nameless_open(const char *folder);
// Names it, unless there is a file of that name. Returns 0, or -1 with errno.
int pci_nameless_link(int descriptor, const char *path);

#endif
