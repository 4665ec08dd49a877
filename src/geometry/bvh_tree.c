#include "geometry/bvh_tree.h"

#include <embree3/rtcore.h>
#include <pthread.h>

#include "core/context.h"
#include "core/embree.h"

// ---- what Embree builds -------------------------------------------------------------------------

// A node or a leaf in Embree's memory.
typedef struct draft {
    size_t child_count, triangle_count; // of which one is 0
    uint32_t triangles[PCI_BVH_LEAF];
    struct draft *children[PCI_BVH_WIDTH]; // leaves end before this
    struct RTCBounds bounds[PCI_BVH_WIDTH];
} draft;

static void *create_node(RTCThreadLocalAllocator allocator, unsigned int child_count, void *user) {
    (void)user;
    draft *node = rtcThreadLocalAlloc(allocator, sizeof(*node), 16);
    node->child_count = child_count;
    node->triangle_count = 0;
    return node;
}

static void set_children(void *node, void **children, unsigned int child_count, void *user) {
    (void)user;
    for (size_t i = 0; i < child_count; ++i) {
        ((draft *)node)->children[i] = children[i];
    }
}

static void set_bounds(void *node, const struct RTCBounds **bounds, unsigned int child_count,
                       void *user) {
    (void)user;
    for (size_t i = 0; i < child_count; ++i) {
        ((draft *)node)->bounds[i] = *bounds[i];
    }
}

static void *create_leaf(RTCThreadLocalAllocator allocator,
                         const struct RTCBuildPrimitive *primitives, size_t count, void *user) {
    (void)user;
    draft *leaf = rtcThreadLocalAlloc(allocator, offsetof(draft, children), 16);
    leaf->child_count = 0;
    leaf->triangle_count = count;
    for (size_t i = 0; i < count; ++i) {
        leaf->triangles[i] = primitives[i].primID;
    }
    return leaf;
}

// A tree of millions of triangles takes seconds. The user is asked only from the thread that
// entered the library, and only during the stage that progress counts for.
typedef struct build_watch {
    pc_context *context;
    pthread_t thread;
    bool wanted;
} build_watch;

static bool watch_build(void *user, double primitives) {
    (void)primitives;
    build_watch *watch = user;
    if (!pthread_equal(watch->thread, pthread_self())) {
        return true;
    }
    watch->wanted = watch->wanted && pci_keep_going(watch->context);
    return watch->wanted;
}

// ---- what is kept of it -------------------------------------------------------------------------

static void count_parts(const draft *part, pci_bvh_tree *tree) {
    ++*(part->child_count > 0 ? &tree->node_count : &tree->leaf_count);
    for (size_t i = 0; i < part->child_count; ++i) {
        count_parts(part->children[i], tree);
    }
}

static uint32_t keep_leaf(pci_bvh_tree *tree, const draft *part) {
    pci_bvh_leaf *leaf = &tree->leaves[tree->leaf_count];
    for (size_t i = 0; i < PCI_BVH_LEAF; ++i) {
        leaf->triangles[i] = i < part->triangle_count ? part->triangles[i] : PC_INVALID_INDEX;
    }
    return 2 * (uint32_t)tree->leaf_count++ + 1;
}

static uint32_t keep_node(pci_bvh_tree *tree, const draft *part) {
    const size_t at = tree->node_count++;
    pci_bvh_node *node = &tree->nodes[at];
    for (size_t i = 0; i < PCI_BVH_WIDTH; ++i) {
        const bool real = i < part->child_count;
        const struct RTCBounds *box = &part->bounds[i];
        node->lower[0][i] = real ? box->lower_x : INFINITY;
        node->lower[1][i] = real ? box->lower_y : INFINITY;
        node->lower[2][i] = real ? box->lower_z : INFINITY;
        node->upper[0][i] = real ? box->upper_x : -INFINITY;
        node->upper[1][i] = real ? box->upper_y : -INFINITY;
        node->upper[2][i] = real ? box->upper_z : -INFINITY;
        if (real) {
            const draft *child = part->children[i];
            node->child[i] =
                child->child_count > 0 ? keep_node(tree, child) : keep_leaf(tree, child);
        }
    }
    return 2 * (uint32_t)at;
}

static bool keep_tree(pci_scratch *memory, const draft *root, pci_bvh_tree *tree) {
    *tree = (pci_bvh_tree){0};
    count_parts(root, tree);
    tree->nodes = pci_scratch_allocate_aligned(memory, tree->node_count, sizeof(*tree->nodes));
    tree->leaves = pci_scratch_allocate_aligned(memory, tree->leaf_count, sizeof(*tree->leaves));
    if (memory->failed) {
        return false;
    }
    tree->node_count = tree->leaf_count = 0;
    (void)keep_node(tree, root);
    return true;
}

static pc_status fail(pc_context *context, const char *stage, enum RTCError error, bool wanted) {
    if (!wanted) {
        return pci_fail_cancelled(context, stage);
    }
    if (error == RTC_ERROR_OUT_OF_MEMORY || error == RTC_ERROR_NONE) {
        return pci_fail_memory(context, stage);
    }
    return pci_fail(context, PC_ERROR_DEPENDENCY, stage, "%s: Embree failed with error %d", stage,
                    (int)error);
}

pc_status pci_bvh_build(pc_context *context, const char *stage, pci_scratch *memory,
                        struct RTCBuildPrimitive *boxes, size_t count, bool careful,
                        pci_bvh_tree *tree) {
    RTCDevice device = pci_embree_device(&context->embree);
    RTCBVH bvh = device == NULL ? NULL : rtcNewBVH(device);
    if (bvh == NULL) {
        return fail(context, stage, rtcGetDeviceError(device), true);
    }
    build_watch watch = {.context = context, .thread = pthread_self(), .wanted = true};
    struct RTCBuildArguments arguments = rtcDefaultBuildArguments();
    arguments.buildQuality = careful ? RTC_BUILD_QUALITY_MEDIUM : RTC_BUILD_QUALITY_LOW;
    arguments.maxBranchingFactor = PCI_BVH_WIDTH;
    arguments.maxDepth = PCI_BVH_LEVELS - 1;
    arguments.sahBlockSize = arguments.minLeafSize = arguments.maxLeafSize = PCI_BVH_LEAF;
    arguments.bvh = bvh;
    arguments.primitives = boxes;
    arguments.primitiveCount = arguments.primitiveArrayCapacity = count;
    arguments.createNode = create_node;
    arguments.setNodeChildren = set_children;
    arguments.setNodeBounds = set_bounds;
    arguments.createLeaf = create_leaf;
    arguments.userPtr = &watch;
    if (context->stage != NULL && strcmp(context->stage, stage) == 0) {
        arguments.buildProgress = watch_build;
    }
    // A tree of one leaf is put below a node whose box is around everything.
    draft root = {.bounds = {{-1.0F, -1.0F, -1.0F, 0.0F, 1.0F, 1.0F, 1.0F, 0.0F}}};
    draft *built = count > 0 ? rtcBuildBVH(&arguments) : &root;
    const enum RTCError error = rtcGetDeviceError(device);
    pc_status status = PC_OK;
    if (error == RTC_ERROR_NONE && built != NULL && built->triangle_count > 0) {
        root.children[0] = built;
        root.child_count = 1;
        built = &root;
    }
    if (!watch.wanted || error != RTC_ERROR_NONE || built == NULL ||
        !keep_tree(memory, built, tree)) {
        status = fail(context, stage, error, watch.wanted);
    }
    rtcReleaseBVH(bvh);
    return status;
}
