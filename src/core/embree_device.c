// The device that all trees of a context share.
#include <embree3/rtcore.h>

#include "core/embree.h"

static void ignore_error(void *user, enum RTCError code, const char *message) {
    (void)user;
    (void)code;
    (void)message;
}

void *pci_embree_device(void **held) {
    if (*held == NULL) {
        *held = rtcNewDevice(pci_embree_configuration());
        if (*held != NULL) {
            rtcSetDeviceErrorFunction(*held, ignore_error, NULL);
        }
    }
    return *held;
}

void pci_embree_release(void *device) {
    if (device != NULL) {
        rtcReleaseDevice(device);
    }
}
