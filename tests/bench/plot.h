// A chart of growth as SVG: both axes logarithmic, one line per series.
#ifndef BENCH_PLOT_H
#define BENCH_PLOT_H

#include <math.h>
#include <stdbool.h>
#include <stdio.h>

typedef struct plot_series {
    const char *name;
    const double *values; // #points; not above 0: left out
} plot_series;

// Slope of the least-squares line through (log x, log y) over the points with y > 0; NaN below two.
static inline double plot_exponent(const double *x, const double *y, size_t count) {
    double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0;
    for (size_t i = 0; i < count; ++i) {
        if (y[i] > 0.0) {
            const double u = log(x[i]), v = log(y[i]);
            n += 1.0, sx += u, sy += v, sxx += u * u, sxy += u * v;
        }
    }
    return (n * sxy - sx * sy) / (n * sxx - sx * sx);
}

static inline double plot_place(double value, double low, double high, double from, double to) {
    return from + (to - from) * (log(value) - log(low)) / (log(high) - log(low));
}

// Ascending `x`. False when the file cannot be written.
static inline bool plot_write(const char *path, const char *x_name, const double *x, size_t points,
                              const plot_series *series, size_t count) {
    static const char *const colors[] = {"#4e79a7", "#f28e2b", "#e15759", "#76b7b2", "#59a14f",
                                         "#edc948", "#b07aa1", "#ff9da7", "#9c755f", "#333333"};
    enum { LEFT = 70, RIGHT = 640, TOP = 20, BOTTOM = 420 };
    FILE *file = fopen(path, "w");
    if (file == NULL) {
        return false;
    }
    double low = INFINITY, high = 0.0;
    for (size_t i = 0; i < points * count; ++i) {
        const double y = series[i / points].values[i % points];
        low = y > 0.0 && y < low ? y : low;
        high = y > high ? y : high;
    }
    low = pow(10.0, floor(log10(low)));
    high = pow(10.0, ceil(log10(high * 1.0001)));
    fprintf(file, "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"820\" height=\"470\" "
                  "font-family=\"sans-serif\" font-size=\"13\">\n"
                  "<rect width=\"820\" height=\"470\" fill=\"white\"/>\n");
    for (double y = low; y <= high * 1.001; y *= 10.0) {
        const double at = plot_place(y, low, high, BOTTOM, TOP);
        fprintf(file,
                "<path d=\"M%d %.1fH%d\" stroke=\"#ddd\"/><text x=\"%d\" y=\"%.1f\" "
                "text-anchor=\"end\">%g s</text>\n",
                LEFT, at, RIGHT, LEFT - 6, at + 4.0, y);
    }
    for (size_t i = 0; i < points; ++i) {
        const double at = plot_place(x[i], x[0], x[points - 1], LEFT, RIGHT);
        fprintf(file,
                "<path d=\"M%.1f %dV%d\" stroke=\"#ddd\"/><text x=\"%.1f\" y=\"%d\" "
                "text-anchor=\"middle\">%g</text>\n",
                at, TOP, BOTTOM, at, BOTTOM + 18, x[i]);
    }
    fprintf(file, "<text x=\"%d\" y=\"%d\" text-anchor=\"middle\">%s</text>\n", (LEFT + RIGHT) / 2,
            BOTTOM + 40, x_name);
    for (size_t s = 0; s < count; ++s) {
        const char *color = colors[s % 10];
        bool down = false;
        fprintf(file, "<path fill=\"none\" stroke=\"%s\" stroke-width=\"2\" d=\"", color);
        for (size_t i = 0; i < points; ++i) {
            if (series[s].values[i] > 0.0) {
                fprintf(file, "%c%.1f %.1f", down ? 'L' : 'M',
                        plot_place(x[i], x[0], x[points - 1], LEFT, RIGHT),
                        plot_place(series[s].values[i], low, high, BOTTOM, TOP));
                down = true;
            }
        }
        fprintf(file, "\"/><text x=\"%d\" y=\"%zu\" fill=\"%s\">%s, exponent %.2f</text>\n",
                RIGHT + 12, TOP + 12 + 22 * s, color, series[s].name,
                plot_exponent(x, series[s].values, points));
    }
    fputs("</svg>\n", file);
    return fclose(file) == 0;
}

#endif
