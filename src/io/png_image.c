// The only place that knows libpng and zlib. libpng writes the file around the pixels; they are
// packed here, in pieces, by all threads.
#include "io/png_image.h"

#include <png.h>
#include <setjmp.h>
#include <zlib.h>

#include "io/atomic_file.h"

static void fail_silently(png_structp png, png_const_charp message) {
    (void)message;
    png_longjmp(png, 1);
}

static void ignore_warning(png_structp png, png_const_charp message) {
    (void)png;
    (void)message;
}

// A failed write is noticed when the file ends.
static void write_bytes(png_structp png, png_bytep bytes, png_size_t size) {
    (void)!fwrite(bytes, 1, size, png_get_io_ptr(png));
}

static void flush_nothing(png_structp png) { (void)png; }

// ---- packing ----------------------------------------------------------------------------------

enum {
    PIECE_BYTES = 1 << 18, // about, of pixels; the same at any number of threads
    ROUND_PIECES = 64      // packed before they are written
};

// Some rows as a part of a deflate stream that needs nothing of the parts before.
typedef struct piece {
    unsigned char *packed;
    size_t packed_size, raw_size;
    uLong checksum; // Adler-32 of the raw bytes
    bool failed;
} piece;

typedef struct packing {
    const pci_image *image;
    size_t piece_rows, piece_count;
    size_t raw_bytes, packed_bytes; // most of a piece
    size_t first;                   // piece of this round
    unsigned char *raw;             // per worker
    piece pieces[ROUND_PIECES];
} packing;

// The filter "up": each byte minus the one above. Most of a contact sheet becomes zeros.
static size_t filter_rows(const pci_image *image, size_t begin, size_t end, unsigned char *raw) {
    const size_t width = 3 * image->width;
    for (size_t row = begin; row < end; ++row) {
        const unsigned char *pixels = &image->pixels[row * width];
        const unsigned char *above = &image->pixels[(row > 0 ? row - 1 : 0) * width];
        *raw++ = 2;
        for (size_t i = 0; i < width; ++i) {
            raw[i] = (unsigned char)(pixels[i] - (row > 0 ? above[i] : 0));
        }
        raw += width;
    }
    return (end - begin) * (width + 1);
}

// By run lengths only: contact sheets become as small as with the other strategies, in a third of
// the time.
static bool pack(unsigned char *raw, piece *p, size_t capacity, bool last) {
    z_stream stream = {.next_in = raw, .avail_in = (uInt)p->raw_size};
    stream.next_out = p->packed;
    stream.avail_out = (uInt)capacity;
    if (deflateInit2(&stream, Z_DEFAULT_COMPRESSION, Z_DEFLATED, -MAX_WBITS, MAX_MEM_LEVEL,
                     Z_RLE) != Z_OK) {
        return false;
    }
    const int result = deflate(&stream, last ? Z_FINISH : Z_FULL_FLUSH);
    p->packed_size = capacity - stream.avail_out;
    p->checksum = adler32(adler32(0, NULL, 0), raw, (uInt)p->raw_size);
    const bool whole = stream.avail_in == 0 && stream.avail_out > 0;
    (void)deflateEnd(&stream); // complains about streams without an end
    return whole && result == (last ? Z_STREAM_END : Z_OK);
}

static void pack_pieces(void *user, size_t begin, size_t end, uint32_t worker) {
    packing *job = user;
    unsigned char *raw = &job->raw[worker * job->raw_bytes];
    for (size_t i = begin; i < end; ++i) {
        piece *p = &job->pieces[i];
        const size_t first = (job->first + i) * job->piece_rows;
        const bool last = job->first + i + 1 == job->piece_count;
        const size_t rows = last ? job->image->height - first : job->piece_rows;
        p->raw_size = filter_rows(job->image, first, first + rows, raw);
        p->failed = !pack(raw, p, job->packed_bytes, last);
    }
}

static bool begin_packing(pc_context *context, pci_scratch *scratch, const pci_image *image,
                          packing *job) {
    const size_t row_bytes = 3 * image->width + 1;
    job->image = image;
    job->piece_rows = row_bytes < PIECE_BYTES ? PIECE_BYTES / row_bytes : 1;
    job->piece_count = (image->height + job->piece_rows - 1) / job->piece_rows;
    job->raw_bytes = job->piece_rows * row_bytes;
    job->packed_bytes = compressBound((uLong)job->raw_bytes) + 64;
    job->raw = PCI_SCRATCH(scratch, unsigned char, pc_context_threads(context) * job->raw_bytes);
    for (size_t i = 0; i < ROUND_PIECES && i < job->piece_count; ++i) {
        job->pieces[i].packed = PCI_SCRATCH(scratch, unsigned char, job->packed_bytes);
    }
    return !scratch->failed;
}

// ---- file -------------------------------------------------------------------------------------

static void write_chunk(png_structp png, const unsigned char *bytes, size_t size) {
    png_write_chunk(png, (png_const_bytep) "IDAT", bytes, size);
}

// False: libpng or zlib failed.
static bool encode(pc_context *context, png_structp png, png_infop info, packing *job) {
    const pci_image *image = job->image;
    if (setjmp(png_jmpbuf(png))) {
        return false;
    }
    png_set_IHDR(png, info, (png_uint_32)image->width, (png_uint_32)image->height, 8,
                 PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT,
                 PNG_FILTER_TYPE_DEFAULT);
    png_set_sRGB(png, info, PNG_sRGB_INTENT_PERCEPTUAL);
    png_write_info(png, info);
    // A zlib stream: its head, what deflate made, and a checksum.
    static const unsigned char head[2] = {0x78, 0x5e};
    write_chunk(png, head, sizeof(head));
    uLong checksum = adler32(0, NULL, 0);
    for (job->first = 0; job->first < job->piece_count; job->first += ROUND_PIECES) {
        const size_t left = job->piece_count - job->first;
        const size_t count = left < ROUND_PIECES ? left : ROUND_PIECES;
        pci_parallel_for(context, count, 1, pack_pieces, job);
        for (size_t i = 0; i < count; ++i) {
            const piece *p = &job->pieces[i];
            if (p->failed) {
                return false;
            }
            write_chunk(png, p->packed, p->packed_size);
            checksum = adler32_combine(checksum, p->checksum, (z_off_t)p->raw_size);
        }
    }
    unsigned char tail[4];
    png_save_uint_32(tail, (png_uint_32)checksum);
    write_chunk(png, tail, sizeof(tail));
    png_write_chunk(png, (png_const_bytep) "IEND", NULL, 0);
    return true;
}

pc_status pci_write_png(pc_context *context, const char *stage, const pci_image *image,
                        const char *path) {
    pci_atomic_file file = {0};
    pc_status status = pci_atomic_begin(context, stage, path, &file);
    if (status != PC_OK) {
        return status;
    }
    png_structp png =
        png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, fail_silently, ignore_warning);
    png_infop info = png != NULL ? png_create_info_struct(png) : NULL;
    pci_scratch scratch = pci_scratch_begin(context);
    packing *job = PCI_SCRATCH(&scratch, packing, 1);
    if (info == NULL || job == NULL || !begin_packing(context, &scratch, image, job)) {
        status = pci_fail_memory(context, stage);
    } else {
        png_set_write_fn(png, file.stream, write_bytes, flush_nothing);
        if (!encode(context, png, info, job)) {
            status = pci_fail(context, PC_ERROR_DEPENDENCY, stage,
                              "%s: libpng cannot encode %zu x %zu pixels", stage, image->width,
                              image->height);
        }
    }
    pci_scratch_end(&scratch);
    png_destroy_write_struct(&png, &info);
    return pci_atomic_end(&file, status);
}
