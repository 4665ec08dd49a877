#include "io/lettering.h"

// Pen strokes of the characters from '!' to '~': polylines of (x, y) digit pairs, separated by
// spaces. The baseline is at y = 2, small letters reach 6, capitals 8. A pair alone is a dot.
static const char *const strokes[] = {
    "2824 22",                              // !
    "1816 3836",                            // "
    "1218 3238 0646 0444",                  // #
    "4738180706153544433212 03 2921",       // $
    "0248 08 42",                           // %
    "420607182837360403122244",             // &
    "2826",                                 // '
    "38262432",                             // (
    "18262412",                             // )
    "2723 1436 1634",                       // *
    "0545 2723",                            // +
    "2211",                                 // ,
    "1535",                                 // -
    "22",                                   // .
    "0148",                                 // /
    "182837332212030718",                   // 0
    "072822 1232",                          // 1
    "07183847460242",                       // 2
    "0718384746354443321203 1535",          // 3
    "32380444",                             // 4
    "480805354443321203",                   // 5
    "38180703123243443505",                 // 6
    "084812",                               // 7
    "1838474635150607 18 1504031232434435", // 8
    "12324347381807061545",                 // 9
    "22 25",                                // :
    "2211 25",                              // ;
    "460442",                               // <
    "0343 0545",                            // =
    "064402",                               // >
    "07183847462524 22",                    // ?
    "34362616141434 4447381807031242",      // @
    "022842 1535",                          // A
    "02083847463505 3544433202",            // B
    "4738180703123243",                     // C
    "02082846442202",                       // D
    "48080242 0535",                        // E
    "480802 0535",                          // F
    "47381807031232434525",                 // G
    "0208 4248 0545",                       // H
    "2228 1232 1838",                       // I
    "3833221203",                           // J
    "0208 4805 1642",                       // K
    "080242",                               // L
    "0208254842",                           // M
    "02084248",                             // N
    "183847433212030718",                   // O
    "02083847463505",                       // P
    "183847433212030718 2442",              // Q
    "02083847463505 2542",                  // R
    "473818070615354443321203",             // S
    "0848 2822",                            // T
    "080312324348",                         // U
    "082248",                               // V
    "0812253248",                           // W
    "0248 0842",                            // X
    "082548 2522",                          // Y
    "08480242",                             // Z
    "38181232",                             // [
    "0841",                                 // backslash
    "18383212",                             // ]
    "162836",                               // ^
    "0141",                                 // _
    "1827",                                 // `
    "4642 4536160503123243",                // a
    "0802 0516364543321203",                // b
    "4536160503123243",                     // c
    "4842 4536160503123243",                // d
    "04444536160503123243",                 // e
    "48382722 1646",                        // f
    "4641301001 4536160503123243",          // g
    "0802 0516364542",                      // h
    "2622 28",                              // i
    "26211000 28",                          // j
    "0802 4604 2542",                       // k
    "2822",                                 // l
    "0602 05162522 25364542",               // m
    "0602 0516364542",                      // n
    "163645433212030516",                   // o
    "0600 0516364543321203",                // p
    "4640 4536160503123243",                // q
    "0602 051636",                          // r
    "45361605143443321203",                 // s
    "28233242 1646",                        // t
    "0603123243 4642",                      // u
    "062246",                               // v
    "0612253246",                           // w
    "0246 0642",                            // x
    "0622 461000",                          // y
    "06460242",                             // z
    "38272615242332",                       // {
    "2921",                                 // |
    "18272635242312",                       // }
    "04153445",                             // ~
};
static const char box_strokes[] = "0208484202";

#define BASELINE 2.0
#define CAPITAL  6.0   // units from the baseline to the top of a capital
#define GAP      2.0   // units between letters
#define SPACE    4.0   // units of a space
#define PEN      0.155 // width over the height of a capital

// The strokes of the next character; NULL for a space. Moves on by a whole UTF-8 character.
static const char *next_glyph(const char **text) {
    const unsigned char first = (unsigned char)*(*text)++;
    if (first == ' ') {
        return NULL;
    }
    if (first > ' ' && first < 0x7f) {
        return strokes[first - '!'];
    }
    while (((unsigned char)**text & 0xc0U) == 0x80U) {
        ++*text;
    }
    return box_strokes;
}

// Leftmost and rightmost coordinate of a character.
static void glyph_extent(const char *glyph, double *left, double *right) {
    *left = 9.0, *right = 0.0;
    for (const char *at = glyph; *at != '\0'; at += *at == ' ' ? 1 : 2) {
        if (*at != ' ') {
            *left = fmin(*left, at[0] - '0');
            *right = fmax(*right, at[0] - '0');
        }
    }
}

double pci_text_width(const char *text, double height) {
    double width = 0.0;
    while (*text != '\0') {
        const char *glyph = next_glyph(&text);
        double left = 0.0, right = SPACE - GAP;
        if (glyph != NULL) {
            glyph_extent(glyph, &left, &right);
        }
        width += right - left + GAP;
    }
    return width * height / CAPITAL;
}

// Darkens the pixels near a line by how much of them the pen covers.
static void draw_stroke(pci_image *image, const double from[2], const double to[2], double pen,
                        const uint8_t color[3]) {
    const double reach = 0.5 * pen + 1.0;
    const size_t left = (size_t)fmax(floor(fmin(from[0], to[0]) - reach), 0.0);
    const size_t top = (size_t)fmax(floor(fmin(from[1], to[1]) - reach), 0.0);
    const double right = fmin(ceil(fmax(from[0], to[0]) + reach), (double)image->width);
    const double bottom = fmin(ceil(fmax(from[1], to[1]) + reach), (double)image->height);
    const double dx = to[0] - from[0], dy = to[1] - from[1], squared = dx * dx + dy * dy;
    for (size_t y = top; (double)y < bottom; ++y) {
        for (size_t x = left; (double)x < right; ++x) {
            const double px = (double)x + 0.5 - from[0], py = (double)y + 0.5 - from[1];
            const double along =
                squared > 0.0 ? fmin(fmax((px * dx + py * dy) / squared, 0.0), 1.0) : 0.0;
            const double beside = px - along * dx, off = py - along * dy;
            const double distance = sqrt(beside * beside + off * off);
            const double cover = fmin(fmax(0.5 * pen + 0.5 - distance, 0.0), 1.0);
            uint8_t *pixel = &image->pixels[3 * (y * image->width + x)];
            for (size_t k = 0; k < 3; ++k) {
                const double ink = 255.0 + cover * ((double)color[k] - 255.0);
                pixel[k] = ink < pixel[k] ? (uint8_t)(ink + 0.5) : pixel[k];
            }
        }
    }
}

double pci_draw_text(pci_image *image, double x, double baseline, double height,
                     const uint8_t color[3], const char *text) {
    const double unit = height / CAPITAL;
    while (*text != '\0') {
        const char *glyph = next_glyph(&text);
        if (glyph == NULL) {
            x += SPACE * unit;
            continue;
        }
        double left, right, from[2], to[2];
        glyph_extent(glyph, &left, &right);
        bool pen_down = false;
        for (const char *at = glyph; *at != '\0'; at += *at == ' ' ? 1 : 2) {
            if (*at == ' ') {
                pen_down = false;
                continue;
            }
            to[0] = x + ((at[0] - '0') - left) * unit;
            to[1] = baseline - ((at[1] - '0') - BASELINE) * unit;
            draw_stroke(image, pen_down ? from : to, to, PEN * height, color);
            from[0] = to[0], from[1] = to[1];
            pen_down = true;
        }
        x += (right - left + GAP) * unit;
    }
    return x;
}
