// Garments like those of games, with the truth known by construction: how many pieces hang
// together, and how many openings they have (necklines, cuffs, hems, the outline of a sheet). What
// overlaps, as a shirt and trousers, is one piece. In metres, y up, facing +z.
#ifndef TEST_SUPPORT_WARDROBE_H
#define TEST_SUPPORT_WARDROBE_H

#include "support/sewing.h"

// How a garment is messed up; 0: not at all.
enum {
    SEW_DOUBLED = 1,  // every triangle again, with the other winding
    SEW_REPEATED = 2, // every triangle again, with the same winding
    SEW_FLIPPED = 4,  // patches with the other winding
    SEW_CRACKED = 8,  // every triangle on its own, seams do not quite meet
    SEW_LINED = 16,   // a lining inside
};

typedef struct sew_garment {
    const char *name;
    pc_mesh (*make)(pc_context *context, double detail);
    double detail; // finer above 1
    unsigned mess;
    double thickness;           // of a closed shell; 0: a sheet
    uint32_t components, loops; // what the garment is; 0 components: nobody can say
} sew_garment;

#define SEW_CELL 0.02

// ---- worn on a body -----------------------------------------------------------------------------

static inline pc_mesh sew_dress_up(pc_context *context, const sew_limb *limbs, size_t count,
                                   double blend, const sew_cut *cuts, size_t cut_count,
                                   double detail) {
    const sew_body body = {limbs, count, blend, 1.4};
    pc_mesh mesh = sew_around(context, &body, SEW_CELL / detail);
    for (size_t i = 0; i < cut_count; ++i) {
        sew_cut_away(context, &mesh, &cuts[i], false);
    }
    return mesh;
}

#define SEW_TORSO(loose)                                                                           \
    { {0.0, 0.95, 0.0}, 0.165 + (loose), {0.0, 1.33, 0.0}, 0.175 + (loose) }
#define SEW_NECK(loose)                                                                            \
    { {0.0, 1.35, 0.0}, 0.1 + (loose), {0.0, 1.6, 0.0}, 0.075 + (loose) }
#define SEW_ARM(side, shoulder, wrist)                                                             \
    { {(side)*0.15, 1.38, 0.0}, shoulder, {(side)*0.62, 1.1, 0.0}, wrist }
#define SEW_SKIRT(length, radius)                                                                  \
    { {0.0, 0.95, 0.0}, 0.165, {0.0, 0.95 - (length), 0.0}, radius }
#define SEW_LEG(side, apart, ankle)                                                                \
    {                                                                                              \
        {(side) * (0.085 + (apart)), 0.9, 0.0}, 0.09, {(side) * ((ankle) + (apart)), 0.05, 0.0},   \
            ankle                                                                                  \
    }
#define SEW_ABOVE(y)                                                                               \
    {                                                                                              \
        .at = {0.0, y, 0.0}, .normal = { 0.0, 1.0, 0.0 }                                           \
    }
#define SEW_BELOW(y)                                                                               \
    {                                                                                              \
        .at = {0.0, y, 0.0}, .normal = { 0.0, -1.0, 0.0 }                                          \
    }
#define SEW_CUFF(side, share)                                                                      \
    {                                                                                              \
        .at = {(side) * (0.15 + (share)*0.47), 1.38 - (share)*0.28, 0.0},                          \
        .normal = {(side)*0.47, -0.28, 0.0}, .within = 0.5                                         \
    }

static inline pc_mesh sew_coat(pc_context *context, double detail) {
    static const sew_limb limbs[] = {SEW_TORSO(0.0), SEW_NECK(0.0), SEW_ARM(1, 0.075, 0.055),
                                     SEW_ARM(-1, 0.075, 0.055), SEW_SKIRT(0.5, 0.23)};
    static const sew_cut cuts[] = {
        SEW_ABOVE(1.53),
        SEW_CUFF(1, 0.9),
        SEW_CUFF(-1, 0.9),
        SEW_BELOW(0.55),
        {.at = {0.0, 1.0, 0.3}, .size = {0.03, 0.8, 0.3}},
    };
    return sew_dress_up(context, limbs, 5, 0.08, cuts, 5, detail);
}

static inline pc_mesh sew_patch(pc_context *context, const pc_mesh *mesh, double x, double y,
                                double z, double width, double height, double distance) {
    const sew_cut frame = {.at = {x, y, z}, .size = {width, height, 0.3}};
    pc_mesh patch = sew_offset(context, mesh, distance, false);
    sew_cut_away(context, &patch, &frame, true);
    return patch;
}

static inline pc_mesh sew_lab_coat(pc_context *context, double detail) {
    pc_mesh coat = sew_coat(context, detail), cloth = sew_offset(context, &coat, 0.0, false);
    sew_add(context, &coat, sew_patch(context, &cloth, 0.13, 0.8, 0.35, 0.06, 0.08, 0.006));
    sew_add(context, &coat, sew_patch(context, &cloth, -0.13, 0.8, 0.35, 0.06, 0.08, 0.006));
    sew_add(context, &coat, sew_patch(context, &cloth, 0.1, 1.25, 0.35, 0.04, 0.05, 0.006));
    for (int i = 0; i < 6; ++i) {
        pc_mesh button = sew_button(context, 0.009, 0.003);
        sew_turn(&button, 0, 0.25);
        sew_move(&button, 0.045, 0.75 + 0.1 * i, 0.13);
        sew_add(context, &coat, button);
    }
    pc_mesh_free(context, &cloth);
    return coat;
}

static inline pc_mesh sew_tunic(pc_context *context, double detail) {
    static const sew_limb limbs[] = {SEW_TORSO(0.0), SEW_NECK(0.0), SEW_ARM(1, 0.08, 0.06),
                                     SEW_ARM(-1, 0.08, 0.06)};
    static const sew_cut cuts[] = {SEW_ABOVE(1.53), SEW_CUFF(1, 0.45), SEW_CUFF(-1, 0.45),
                                   SEW_BELOW(0.9)};
    return sew_dress_up(context, limbs, 4, 0.08, cuts, 4, detail);
}

static inline pc_mesh sew_dress(pc_context *context, double detail) {
    static const sew_limb limbs[] = {SEW_TORSO(-0.02), SEW_NECK(0.0), SEW_ARM(1, 0.045, 0.026),
                                     SEW_ARM(-1, 0.045, 0.026), SEW_SKIRT(0.85, 0.4)};
    static const sew_cut cuts[] = {SEW_ABOVE(1.5), SEW_CUFF(1, 0.95), SEW_CUFF(-1, 0.95),
                                   SEW_BELOW(0.2)};
    return sew_dress_up(context, limbs, 5, 0.06, cuts, 4, detail);
}

static inline pc_mesh sew_kimono(pc_context *context, double detail) {
    static const sew_limb limbs[] = {SEW_TORSO(0.0),
                                     SEW_NECK(0.0),
                                     {{0.15, 1.35, 0.0}, 0.08, {0.6, 1.25, 0.0}, 0.17},
                                     {{-0.15, 1.35, 0.0}, 0.08, {-0.6, 1.25, 0.0}, 0.17},
                                     SEW_SKIRT(0.85, 0.22)};
    static const sew_cut cuts[] = {
        SEW_ABOVE(1.53),
        {.at = {0.58, 1.2, 0.0}, .normal = {1.0, 0.0, 0.0}},
        {.at = {-0.58, 1.2, 0.0}, .normal = {-1.0, 0.0, 0.0}},
        SEW_BELOW(0.2),
        {.at = {0.0, 0.6, 0.4}, .size = {0.02, 1.2, 0.4}},
    };
    return sew_dress_up(context, limbs, 5, 0.08, cuts, 5, detail);
}

static inline pc_mesh sew_robe(pc_context *context, double detail) {
    static const sew_limb limbs[] = {
        SEW_TORSO(0.03),       SEW_NECK(0.02),
        SEW_ARM(1, 0.09, 0.1), SEW_ARM(-1, 0.09, 0.1),
        SEW_SKIRT(0.9, 0.32),  {{0.0, 1.62, -0.02}, 0.14, {0.0, 1.7, -0.05}, 0.14}};
    static const sew_cut cuts[] = {
        SEW_CUFF(1, 0.9),
        SEW_CUFF(-1, 0.9),
        SEW_BELOW(0.15),
        {.at = {0.0, 1.7, 0.02}, .normal = {0.0, 0.25, 1.0}, .within = 0.25},
    };
    return sew_dress_up(context, limbs, 6, 0.08, cuts, 4, detail);
}

static inline pc_mesh sew_top(pc_context *context, double detail) {
    static const sew_limb limbs[] = {SEW_TORSO(0.0), SEW_NECK(0.03)};
    static const sew_cut cuts[] = {
        SEW_ABOVE(1.45),
        SEW_BELOW(0.95),
        {.at = {0.19, 1.28, 0.0}, .size = {0.07, 0.08, 0.3}},
        {.at = {-0.19, 1.28, 0.0}, .size = {0.07, 0.08, 0.3}},
    };
    return sew_dress_up(context, limbs, 2, 0.08, cuts, 4, detail);
}

static inline pc_mesh sew_legs(pc_context *context, double apart, double ankle, double blend,
                               double detail) {
    const sew_limb limbs[] = {{{0.0, 1.05, 0.0}, 0.15, {0.0, 0.93, 0.0}, 0.16},
                              SEW_LEG(1, apart, ankle),
                              SEW_LEG(-1, apart, ankle)};
    static const sew_cut cuts[] = {SEW_ABOVE(1.05), SEW_BELOW(0.1)};
    return sew_dress_up(context, limbs, 3, blend, cuts, 2, detail);
}

static inline pc_mesh sew_trousers(pc_context *context, double detail) {
    return sew_legs(context, 0.03, 0.06, 0.05, detail);
}

static inline pc_mesh sew_trousers_close(pc_context *context, double detail) {
    return sew_legs(context, 0.008, 0.088, 0.004, 1.5 * detail);
}

static inline pc_mesh sew_leggings(pc_context *context, double detail) {
    return sew_legs(context, 0.05, 0.035, 0.05, detail);
}

static inline pc_mesh sew_suit(pc_context *context, double detail) {
    static const sew_limb limbs[] = {SEW_TORSO(0.02), SEW_NECK(-0.02), SEW_ARM(1, 0.085, 0.06),
                                     SEW_ARM(-1, 0.085, 0.06)};
    static const sew_cut cuts[] = {
        SEW_ABOVE(1.5),
        SEW_CUFF(1, 0.9),
        SEW_CUFF(-1, 0.9),
        SEW_BELOW(0.85),
        {.at = {0.0, 1.0, 0.3}, .size = {0.05, 0.45, 0.3}},
    };
    pc_mesh suit = sew_dress_up(context, limbs, 4, 0.08, cuts, 5, detail);
    sew_add(context, &suit, sew_tunic(context, detail));
    sew_add(context, &suit, sew_trousers(context, detail));
    return suit;
}

static inline pc_mesh sew_two_pieces(pc_context *context, double detail) {
    pc_mesh both = sew_top(context, detail);
    const sew_lathe skirt = {.profile = {{0.15, 0.78}, {0.2, 0.6}, {0.3, 0.3}},
                             .points = 3,
                             .around = 36,
                             .along = 16,
                             .to = 1.0};
    sew_add(context, &both, sew_turned(context, &skirt, detail));
    return both;
}

// A dress of shells: sleeves that only stick in the body.
static inline pc_mesh sew_shells(pc_context *context, double detail) {
    static const sew_limb body[] = {SEW_TORSO(0.0), SEW_NECK(0.0), SEW_SKIRT(0.7, 0.3)};
    static const sew_cut ends[] = {SEW_ABOVE(1.53), SEW_BELOW(0.35)};
    pc_mesh dress = sew_dress_up(context, body, 3, 0.08, ends, 2, detail);
    for (int side = -1; side <= 1; side += 2) {
        const sew_limb arm[] = {SEW_ARM(side, 0.075, 0.06)};
        const sew_cut cuts[] = {SEW_CUFF(side, 0.85), {.size = {0.14, 3.0, 1.0}}};
        sew_add(context, &dress, sew_dress_up(context, arm, 1, 0.01, cuts, 2, detail));
    }
    return dress;
}

static inline pc_mesh sew_glove(pc_context *context, double detail) {
    sew_limb limbs[6] = {{{0.0, 0.0, 0.0}, 0.04, {0.0, 0.06, 0.0}, 0.045}};
    for (int i = 0; i < 4; ++i) {
        const double x = -0.036 + 0.024 * i;
        limbs[i + 1] = (sew_limb){{x, 0.07, 0.0}, 0.0115, {1.3 * x, 0.15, 0.0}, 0.009};
    }
    limbs[5] = (sew_limb){{0.03, 0.02, 0.0}, 0.014, {0.085, 0.075, 0.01}, 0.01};
    const sew_body body = {limbs, 6, 0.008, 1.4};
    const sew_cut wrist = {.at = {0.0, -0.03, 0.0}, .normal = {0.0, -1.0, 0.0}};
    pc_mesh glove = sew_around(context, &body, 0.005 / detail);
    sew_cut_away(context, &glove, &wrist, false);
    return glove;
}

static inline pc_mesh sew_socks(pc_context *context, double detail) {
    pc_mesh socks = {0};
    for (int side = -1; side <= 1; side += 2) {
        const double x = 0.12 * side;
        const sew_limb limbs[] = {{{x, 0.05, 0.0}, 0.045, {x, 0.35, 0.0}, 0.06},
                                  {{x, 0.05, 0.0}, 0.045, {x, 0.035, 0.15}, 0.035}};
        const sew_body body = {limbs, 2, 0.02, 1.0};
        const sew_cut top = SEW_ABOVE(0.33);
        pc_mesh sock = sew_around(context, &body, 0.012 / detail);
        sew_cut_away(context, &sock, &top, false);
        sew_add(context, &socks, sock);
    }
    return socks;
}

static inline pc_mesh sew_hood(pc_context *context, double detail) {
    static const sew_limb limbs[] = {{{0.0, 0.1, 0.0}, 0.15, {0.0, 0.16, -0.04}, 0.15},
                                     {{0.0, 0.1, 0.0}, 0.1, {0.0, -0.1, 0.0}, 0.2}};
    static const sew_cut cuts[] = {SEW_BELOW(-0.1),
                                   {.at = {0.0, 0.1, 0.07}, .normal = {0.0, 0.0, 1.0}}};
    return sew_dress_up(context, limbs, 2, 0.05, cuts, 2, detail);
}

// ---- turned -------------------------------------------------------------------------------------

static inline pc_mesh sew_cape(pc_context *context, double detail) {
    const sew_lathe lathe = {.profile = {{0.12, 1.5}, {0.24, 1.35}, {0.3, 0.9}, {0.45, 0.2}},
                             .points = 4,
                             .around = 14,
                             .along = 16,
                             .from = 0.25,
                             .to = 0.75,
                             .squash = 0.6,
                             .pleats = 12,
                             .depth = 0.08};
    return sew_turned(context, &lathe, detail);
}

static inline pc_mesh sew_flat_cape(pc_context *context, double detail) {
    static const sew_knot knots[] = {{{0.0, 1.4, -0.1}, {0.15, 0.0, 0.0}},
                                     {{0.0, 1.0, -0.16}, {0.2, 0.0, 0.0}},
                                     {{0.0, 0.3, -0.3}, {0.3, 0.0, 0.0}}};
    return sew_ribbon(context, knots, 3, 4, 5, detail);
}

static inline pc_mesh sew_poncho(pc_context *context, double detail) {
    const sew_lathe lathe = {.profile = {{0.1, 1.5}, {0.25, 1.4}, {0.5, 1.0}, {0.6, 0.75}},
                             .points = 4,
                             .around = 40,
                             .along = 18,
                             .to = 1.0,
                             .squash = 0.75,
                             .pleats = 9,
                             .depth = 0.06};
    return sew_turned(context, &lathe, detail);
}

static inline pc_mesh sew_skirt(pc_context *context, double waist, double hem, double length,
                                uint32_t pleats, double depth, double detail) {
    const sew_lathe lathe = {.profile = {{waist, 1.0}, {hem, 1.0 - length}},
                             .points = 2,
                             .around = pleats > 16 ? 4 * pleats : 48,
                             .along = 16,
                             .to = 1.0,
                             .squash = 0.8,
                             .pleats = pleats,
                             .depth = depth};
    return sew_turned(context, &lathe, detail);
}

// Five layers, each a little wider.
static inline pc_mesh sew_petticoat(pc_context *context, double detail) {
    pc_mesh skirt = {0};
    for (uint32_t i = 0; i < 5; ++i) {
        sew_add(context, &skirt,
                sew_skirt(context, 0.15 + 0.002 * i, 0.3 + 0.025 * i, 0.55 + 0.01 * i, 11 + 2 * i,
                          0.05, detail));
    }
    return skirt;
}

// Five tiers, each shorter and above the one before.
static inline pc_mesh sew_tiers(pc_context *context, double detail) {
    pc_mesh skirt = {0};
    for (uint32_t i = 0; i < 5; ++i) {
        sew_add(context, &skirt,
                sew_skirt(context, 0.15 + 0.004 * i, 0.36 - 0.02 * i, 0.9 - 0.16 * i, 14, 0.04,
                          detail));
    }
    return skirt;
}

static inline pc_mesh sew_pleated(pc_context *context, double detail) {
    return sew_skirt(context, 0.15, 0.3, 0.5, 24, 0.12, detail);
}

static inline pc_mesh sew_plain_skirt(pc_context *context, double detail) {
    return sew_skirt(context, 0.15, 0.3, 0.6, 8, 0.08, detail);
}

// A band with loops, studs and a buckle: fifty parts.
static inline pc_mesh sew_belt(pc_context *context, double detail) {
    const sew_lathe band = {.profile = {{0.16, 1.0}, {0.165, 0.95}},
                            .points = 2,
                            .around = 40,
                            .along = 3,
                            .to = 1.0,
                            .squash = 0.75};
    const sew_lathe loop = {.profile = {{0.172, 1.008}, {0.176, 0.942}},
                            .points = 2,
                            .around = 4,
                            .along = 3,
                            .from = -0.01,
                            .to = 0.01,
                            .squash = 0.75};
    pc_mesh belt = sew_turned(context, &band, detail);
    for (int i = 0; i < 8; ++i) {
        sew_lathe l = loop;
        l.from += 0.0625 + 0.125 * i, l.to += 0.0625 + 0.125 * i;
        sew_add(context, &belt, sew_turned(context, &l, detail));
    }
    for (int i = 0; i < 40; ++i) {
        const double turn = 0.02 + 0.96 / 40.0 * i, angle = 2.0 * SEW_PI * turn;
        pc_mesh stud = sew_button(context, 0.006, 0.004);
        sew_turn(&stud, 0, 0.25);
        sew_turn(&stud, 1, turn);
        sew_move(&stud, 0.164 * sin(angle), 0.975, 0.123 * cos(angle));
        sew_add(context, &belt, stud);
    }
    pc_mesh buckle = sew_button(context, 0.035, 0.008);
    sew_turn(&buckle, 0, 0.25);
    sew_move(&buckle, 0.0, 0.975, 0.13);
    sew_add(context, &belt, buckle);
    return belt;
}

static inline pc_mesh sew_belt_with_pouches(pc_context *context, double detail) {
    pc_mesh belt = sew_belt(context, detail);
    for (int i = 0; i < 4; ++i) {
        const double angle = 2.0 * SEW_PI * (0.2 + 0.2 * i);
        pc_mesh pouch = test_sphere(context, 4);
        for (size_t v = 0; v < 3 * pouch.vertex_count; ++v) {
            pouch.positions[v] *= v % 3 == 1 ? 0.05 : 0.04;
        }
        sew_move(&pouch, 0.19 * sin(angle), 0.93, 0.15 * cos(angle));
        sew_add(context, &belt, pouch);
    }
    return belt;
}

static inline pc_mesh sew_hat(pc_context *context, double detail) {
    const sew_lathe lathe = {.profile = {{0.0, 0.14}, {0.06, 0.14}, {0.09, 0.0}, {0.25, -0.02}},
                             .points = 4,
                             .around = 32,
                             .along = 15,
                             .to = 1.0,
                             .squash = 1.15};
    return sew_turned(context, &lathe, detail);
}

static inline pc_mesh sew_witch_hat(pc_context *context, double detail) {
    const sew_lathe lathe = {.profile = {{0.0, 0.45}, {0.03, 0.3}, {0.1, 0.0}, {0.28, 0.01}},
                             .points = 4,
                             .around = 28,
                             .along = 18,
                             .to = 1.0};
    pc_mesh hat = sew_turned(context, &lathe, detail);
    sew_lathe band = {.profile = {{0.105, 0.005}, {0.095, 0.04}},
                      .points = 2,
                      .around = 28,
                      .along = 2,
                      .to = 1.0};
    sew_add(context, &hat, sew_turned(context, &band, detail));
    return hat;
}

static inline pc_mesh sew_snood(pc_context *context, double detail) {
    const sew_lathe lathe = {.profile = {{0.09, 0.15}, {0.12, 0.1}, {0.13, 0.0}, {0.16, -0.08}},
                             .points = 4,
                             .around = 32,
                             .along = 12,
                             .to = 1.0,
                             .pleats = 7,
                             .depth = 0.06};
    return sew_turned(context, &lathe, detail);
}

static inline pc_mesh sew_bag(pc_context *context, double detail) {
    const sew_lathe sack = {.profile = {{0.0, 0.0}, {0.14, 0.0}, {0.16, 0.03}, {0.15, 0.22}},
                            .points = 4,
                            .around = 28,
                            .along = 18,
                            .to = 1.0,
                            .squash = 0.4};
    static const sew_knot strap[] = {{{0.155, 0.15, 0.0}, {0.0, 0.0, 0.015}},
                                     {{0.15, 0.3, 0.0}, {0.0, 0.0, 0.015}},
                                     {{0.0, 0.55, 0.0}, {0.0, 0.0, 0.015}},
                                     {{-0.15, 0.3, 0.0}, {0.0, 0.0, 0.015}},
                                     {{-0.155, 0.15, 0.0}, {0.0, 0.0, 0.015}}};
    pc_mesh bag = sew_turned(context, &sack, detail);
    sew_add(context, &bag, sew_ribbon(context, strap, 5, 2, 30, detail));
    return bag;
}

// ---- ribbons ------------------------------------------------------------------------------------

// Once around the neck, both ends in front.
static inline pc_mesh sew_scarf(pc_context *context, double detail) {
    static const sew_knot knots[] = {
        {{0.08, 0.9, 0.16}, {0.05, 0.0, 0.0}},   {{0.08, 1.3, 0.16}, {0.05, 0.0, 0.0}},
        {{0.1, 1.45, 0.08}, {0.0, 0.04, 0.02}},  {{0.1, 1.5, -0.04}, {0.0, 0.04, 0.02}},
        {{0.0, 1.5, -0.11}, {0.0, 0.04, 0.0}},   {{-0.1, 1.5, -0.04}, {0.0, 0.04, 0.02}},
        {{-0.1, 1.45, 0.08}, {0.0, 0.04, 0.02}}, {{-0.08, 1.3, 0.17}, {-0.05, 0.0, 0.0}},
        {{-0.08, 1.0, 0.17}, {-0.05, 0.0, 0.0}},
    };
    return sew_ribbon(context, knots, 9, 4, 64, detail);
}

// Two panels that hang from the shoulders.
static inline pc_mesh sew_tabard(pc_context *context, double detail) {
    static const sew_knot knots[] = {
        {{0.0, 0.6, 0.2}, {0.2, 0.0, 0.0}},    {{0.0, 1.0, 0.18}, {0.2, 0.0, 0.0}},
        {{0.0, 1.35, 0.15}, {0.2, 0.0, 0.0}},  {{0.0, 1.45, 0.0}, {0.2, 0.0, 0.0}},
        {{0.0, 1.35, -0.15}, {0.2, 0.0, 0.0}}, {{0.0, 1.0, -0.18}, {0.2, 0.0, 0.0}},
        {{0.0, 0.6, -0.2}, {0.2, 0.0, 0.0}},
    };
    const sew_cut neck = {.at = {0.0, 1.45, 0.02}, .size = {0.09, 0.2, 0.1}};
    pc_mesh tabard = sew_ribbon(context, knots, 7, 12, 60, detail);
    sew_cut_away(context, &tabard, &neck, false);
    return tabard;
}

// Two cloths on a belt.
static inline pc_mesh sew_loincloth(pc_context *context, double detail) {
    const sew_lathe band = {.profile = {{0.16, 1.0}, {0.165, 0.95}},
                            .points = 2,
                            .around = 40,
                            .along = 3,
                            .to = 1.0,
                            .squash = 0.75};
    pc_mesh cloth = sew_turned(context, &band, detail);
    for (int side = -1; side <= 1; side += 2) {
        const sew_knot knots[] = {{{0.0, 0.98, side * 0.128}, {side * 0.1, 0.0, 0.0}},
                                  {{0.0, 0.8, side * 0.15}, {side * 0.1, 0.0, 0.0}},
                                  {{0.0, 0.5, side * 0.18}, {side * 0.12, 0.0, 0.0}}};
        sew_add(context, &cloth, sew_ribbon(context, knots, 3, 6, 14, detail));
    }
    return cloth;
}

static inline pc_mesh sew_apron(pc_context *context, double detail) {
    static const sew_knot sheet[] = {{{0.0, 1.35, 0.12}, {0.1, 0.0, 0.0}},
                                     {{0.0, 1.1, 0.15}, {0.15, 0.0, 0.0}},
                                     {{0.0, 1.0, 0.16}, {0.2, 0.0, 0.0}},
                                     {{0.0, 0.55, 0.2}, {0.22, 0.0, 0.0}}};
    static const sew_knot neck[] = {{{0.09, 1.33, 0.12}, {0.012, 0.0, 0.0}},
                                    {{0.09, 1.45, 0.04}, {0.012, 0.0, 0.0}},
                                    {{0.0, 1.5, -0.08}, {0.0, 0.012, 0.0}},
                                    {{-0.09, 1.45, 0.04}, {-0.012, 0.0, 0.0}},
                                    {{-0.09, 1.33, 0.12}, {-0.012, 0.0, 0.0}}};
    pc_mesh apron = sew_ribbon(context, sheet, 4, 10, 24, detail);
    sew_add(context, &apron, sew_ribbon(context, neck, 5, 1, 30, detail));
    return apron;
}

// ---- the wardrobe -------------------------------------------------------------------------------

static const sew_garment sew_wardrobe[] = {
    {"apron", sew_apron, 1.0, 0, 0.0, 1, 2},
    {"bag", sew_bag, 1.0, 0, 0.0, 0, 0},
    {"bag_thick", sew_bag, 1.0, 0, 0.01, 0, 0},
    {"belt", sew_belt, 1.0, 0, 0.0, 1, 2},
    {"belt_with_pouches", sew_belt_with_pouches, 1.0, 0, 0.0, 1, 2},
    {"cape", sew_cape, 1.0, 0, 0.0, 1, 1},
    {"cape_doubled", sew_cape, 1.0, SEW_DOUBLED, 0.0, 1, 1},
    {"cape_doubled_cracked", sew_cape, 1.0, SEW_DOUBLED | SEW_CRACKED, 0.0, 1, 1},
    {"cape_repeated", sew_cape, 2.0, SEW_REPEATED, 0.0, 1, 1},
    {"cape_flat_doubled", sew_flat_cape, 1.0, SEW_DOUBLED, 0.0, 1, 1},
    {"cape_lined", sew_cape, 1.5, SEW_LINED, 0.0, 1, 1},
    {"cape_thick", sew_cape, 1.5, 0, 0.03, 1, 1},
    {"cape_very_thick", sew_cape, 1.5, 0, 0.06, 1, 1},
    {"coat", sew_coat, 1.0, 0, 0.0, 1, 3},
    {"coat_coarse", sew_coat, 0.5, SEW_FLIPPED, 0.0, 1, 3},
    {"coat_lined", sew_coat, 1.0, SEW_LINED, 0.0, 1, 3},
    {"coat_thick", sew_coat, 1.0, 0, 0.02, 1, 3},
    {"dress", sew_dress, 1.0, 0, 0.0, 1, 4},
    {"dress_of_shells", sew_shells, 1.0, 0, 0.0, 1, 4},
    {"glove", sew_glove, 1.0, 0, 0.0, 1, 1},
    {"glove_thick", sew_glove, 1.0, 0, 0.003, 1, 1},
    {"hat", sew_hat, 1.0, 0, 0.0, 1, 1},
    {"hat_doubled", sew_hat, 1.0, SEW_DOUBLED, 0.0, 1, 1},
    {"hat_thick", sew_hat, 1.0, 0, 0.008, 1, 1},
    {"hood", sew_hood, 1.0, 0, 0.0, 1, 1},
    {"hood_thick", sew_hood, 1.0, SEW_FLIPPED, 0.015, 1, 1},
    {"kimono", sew_kimono, 1.5, 0, 0.0, 1, 3},
    {"kimono_lined", sew_kimono, 1.5, SEW_LINED, 0.0, 1, 3},
    {"lab_coat", sew_lab_coat, 1.0, 0, 0.0, 1, 3},
    {"lab_coat_fine", sew_lab_coat, 2.0, 0, 0.0, 1, 3},
    {"lab_coat_cracked", sew_lab_coat, 1.0, SEW_CRACKED, 0.0, 1, 3},
    {"lab_coat_thick", sew_lab_coat, 1.0, 0, 0.006, 1, 3},
    {"leggings", sew_leggings, 1.0, 0, 0.0, 1, 3},
    {"leggings_flipped", sew_leggings, 1.0, SEW_FLIPPED, 0.01, 1, 3},
    {"loincloth", sew_loincloth, 1.0, 0, 0.0, 1, 2},
    {"loincloth_doubled", sew_loincloth, 1.0, SEW_DOUBLED, 0.0, 1, 2},
    {"poncho", sew_poncho, 1.0, 0, 0.0, 1, 2},
    {"poncho_thick", sew_poncho, 1.0, 0, 0.02, 1, 2},
    {"robe", sew_robe, 1.0, 0, 0.0, 1, 4},
    {"robe_thick", sew_robe, 1.0, 0, 0.04, 1, 4},
    {"scarf", sew_scarf, 1.0, 0, 0.0, 1, 1},
    {"scarf_thick", sew_scarf, 1.0, 0, 0.01, 1, 1},
    {"skirt", sew_plain_skirt, 1.0, 0, 0.0, 1, 2},
    {"skirt_layers", sew_petticoat, 1.0, 0, 0.0, 1, 2},
    {"skirt_layers_doubled", sew_petticoat, 1.0, SEW_DOUBLED, 0.0, 1, 2},
    {"skirt_pleated", sew_pleated, 1.0, 0, 0.0, 1, 2},
    {"skirt_tiers", sew_tiers, 1.0, 0, 0.0, 1, 2},
    {"snood", sew_snood, 1.0, 0, 0.0, 1, 2},
    {"snood_thick", sew_snood, 1.0, 0, 0.02, 1, 2},
    {"socks", sew_socks, 1.0, 0, 0.0, 2, 2},
    {"suit", sew_suit, 1.0, 0, 0.0, 1, 5},
    {"suit_flipped", sew_suit, 1.0, SEW_FLIPPED | SEW_CRACKED, 0.0, 1, 5},
    {"tabard", sew_tabard, 1.0, 0, 0.0, 1, 2},
    {"top", sew_top, 1.0, 0, 0.0, 1, 4},
    {"trousers", sew_trousers, 1.0, 0, 0.0, 1, 3},
    {"trousers_close", sew_trousers_close, 1.0, 0, 0.0, 1, 3},
    {"trousers_lined", sew_trousers, 1.0, SEW_LINED, 0.0, 1, 3},
    {"tunic", sew_tunic, 1.0, 0, 0.0, 1, 4},
    {"tunic_coarse", sew_tunic, 0.4, SEW_CRACKED, 0.0, 1, 4},
    {"tunic_thick", sew_tunic, 1.0, 0, 0.03, 1, 4},
    {"two_pieces", sew_two_pieces, 1.0, 0, 0.0, 2, 6},
    {"witch_hat", sew_witch_hat, 1.0, 0, 0.0, 1, 1},
    {"witch_hat_thick", sew_witch_hat, 1.0, 0, 0.01, 1, 1},
};
enum { sew_wardrobe_size = sizeof(sew_wardrobe) / sizeof(sew_wardrobe[0]) };

static inline pc_mesh sew_make(pc_context *context, const sew_garment *garment) {
    pc_mesh mesh = garment->make(context, garment->detail);
    if (garment->mess & SEW_LINED) {
        sew_add(context, &mesh, sew_offset(context, &mesh, -0.008, true));
    }
    if (garment->thickness > 0.0) {
        sew_thicken(context, &mesh, garment->thickness);
    }
    if (garment->mess & (SEW_DOUBLED | SEW_REPEATED)) {
        sew_add(context, &mesh,
                sew_offset(context, &mesh, 0.0, (garment->mess & SEW_DOUBLED) != 0));
        sew_weld(context, &mesh);
    }
    if (garment->mess & SEW_FLIPPED) {
        sew_flip_patches(&mesh, 100);
    }
    if (garment->mess & SEW_CRACKED) {
        sew_crack(context, &mesh, 2e-4);
    }
    return mesh;
}

#endif
