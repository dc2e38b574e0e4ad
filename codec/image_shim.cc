// Images by OpenImageIO: 8-bit RGB in, .jpg .png .webp .tif out.
//
// Files are encoded in memory, get their EXIF block from exif.c, and reach the disk through
// file_write, so no half image is ever left behind. OpenImageIO runs single-threaded here: callers
// work on many images at once, and results must not depend on a thread count.
//
// SPDX-License-Identifier: Apache-2.0
#include "codec/exif.h"
#include "codec/image.h"
#include "codec/limits.h"
#include "codec/png.h"
#include "codec/webp.h"
#include "core/shim.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <cstring>
#include <memory>
#include <new>
#include <string>
#include <strings.h>
#include <vector>

static constexpr int JPEG_FULL_CHROMA_QUALITY = 95; // from here on chroma is not subsampled

// Memory of ours while OpenImageIO, which may throw, fills it.
using image_owned = std::unique_ptr<void, void (*)(void *)>;

static void image_single_thread()
{
    static const bool once = OIIO::attribute("threads", 1);
    (void)once;
}

// OpenImageIO's messages may span lines; the first one is enough for ours.
static std::string image_first_line(const std::string &s)
{
    std::string t = s.substr(0, s.find('\n'));
    return t.empty() ? std::string("unknown reason") : t;
}

static std::unique_ptr<OIIO::ImageInput> image_open_input(const char *path, enum err_code *rc,
                                                          struct err *e)
{
    image_single_thread();
    OIIO::ImageSpec config;
    config.attribute("oiio:UnassociatedAlpha", 1); // colours as stored, not multiplied by alpha
    std::unique_ptr<OIIO::ImageInput> in;
    if (!file_exists(path)) {
        *rc = err_set(e, ERR_NOENT, "image : %s : no such file", path);
        return in;
    }
    in = OIIO::ImageInput::open(path, &config);
    if (!in) {
        std::string why = image_first_line(OIIO::geterror());
        *rc = err_set(e, ERR_FORMAT, "image : %s : not an image that can be read (%s)", path,
                      why.c_str());
        return in;
    }
    const OIIO::ImageSpec &s = in->spec();
    if (s.width < 1 || s.height < 1 || s.depth > 1 || s.nchannels < 1) {
        *rc = err_set(e, ERR_FORMAT, "image : %s : %d x %d x %d pixels of %d channels", path,
                      s.width, s.height, s.depth, s.nchannels);
        in.reset();
    }
    return in;
}

extern "C" enum err_code image_alloc(uint32_t width_px, uint32_t height_px, uint32_t channels,
                                     struct image *out, struct err *e)
{
    *out = {};
    if (channels != 1 && channels != 3 && channels != 4)
        return err_set(e, ERR_ARG, "image : %u channels : only 1, 3 and 4 are known", channels);
    out->px = static_cast<uint8_t *>(mem_array((size_t)width_px * height_px, channels));
    if (!out->px)
        return err_set(e, ERR_MEM, "image : %u x %u : out of memory", width_px, height_px);
    out->width_px = width_px;
    out->height_px = height_px;
    out->channels = channels;
    return ERR_OK;
}

extern "C" void image_free(struct image *img)
{
    mem_free(img->px);
    *img = {};
}

extern "C" enum err_code image_read(const char *path, const struct codec_limits *lim,
                                    struct image *out, struct err *e)
try {
    *out = {};
    enum err_code rc = ERR_OK;
    std::unique_ptr<OIIO::ImageInput> in = image_open_input(path, &rc, e);
    if (!in)
        return rc;
    const OIIO::ImageSpec s = in->spec();
    size_t limit = lim && lim->max_pixels ? lim->max_pixels : CODEC_MAX_PIXELS;
    if ((size_t)s.width * (size_t)s.height > limit)
        return err_set(e, ERR_LIMIT, "image : %s : %d x %d pixels are more than the limit of %zu",
                       path, s.width, s.height, limit);
    struct image img = {};
    if ((rc = image_alloc((uint32_t)s.width, (uint32_t)s.height, 3, &img, e)) != ERR_OK)
        return rc;
    image_owned px(img.px, mem_free);    // OpenImageIO may throw
    int take = s.nchannels >= 3 ? 3 : 1; // 2 is grey + alpha
    bool ok = in->read_image(0, 0, 0, take, OIIO::TypeDesc::UINT8, img.px, 3);
    std::string why = in->geterror();
    if (!ok || !why.empty())
        return err_set(e, ERR_FORMAT, "image : %s : damaged or truncated (%s)", path,
                       image_first_line(why).c_str());
    if (take == 1)
        for (size_t i = 0; i < (size_t)s.width * (size_t)s.height; i++)
            img.px[3 * i + 1] = img.px[3 * i + 2] = img.px[3 * i];
    *out = img;
    px.release();
    return ERR_OK;
}
SHIM_CATCH("image_read", ERR_FORMAT)

extern "C" enum err_code image_read_map(const char *path, const struct codec_limits *lim,
                                        uint32_t *width_px, uint32_t *height_px, float **data,
                                        struct err *e)
try {
    *data = nullptr;
    enum err_code rc = ERR_OK;
    std::unique_ptr<OIIO::ImageInput> in = image_open_input(path, &rc, e);
    if (!in)
        return rc;
    const OIIO::ImageSpec s = in->spec();
    size_t n = (size_t)s.width * (size_t)s.height;
    size_t limit = lim && lim->max_pixels ? lim->max_pixels : CODEC_MAX_PIXELS;
    if (n > limit)
        return err_set(e, ERR_LIMIT, "image : %s : %d x %d pixels are more than the limit of %zu",
                       path, s.width, s.height, limit);
    image_owned px(mem_array(n, sizeof(float)), mem_free);
    if (!px)
        return err_set(e, ERR_MEM, "image : %s : out of memory for %zu pixels", path, n);
    bool ok = in->read_image(0, 0, 0, 1, OIIO::TypeDesc::FLOAT, px.get());
    std::string why = in->geterror();
    if (!ok || !why.empty())
        return err_set(e, ERR_FORMAT, "image : %s : damaged or truncated (%s)", path,
                       image_first_line(why).c_str());
    *width_px = (uint32_t)s.width;
    *height_px = (uint32_t)s.height;
    *data = static_cast<float *>(px.release());
    return ERR_OK;
}
SHIM_CATCH("image_read_map", ERR_FORMAT)

// XMP as OpenImageIO has it: "prefix:Name", of a type that it guesses.
static bool image_attribute(const void *spec, const char *name, char *text, size_t room)
{
    const OIIO::ParamValue *v = static_cast<const OIIO::ImageSpec *>(spec)->find_attribute(name);
    if (!v)
        return false;
    int n = v->type() == OIIO::TypeFloat
                ? snprintf(text, room, "%.9g", (double)*static_cast<const float *>(v->data()))
                : snprintf(text, room, "%s", v->get_string().c_str());
    return n > 0 && (size_t)n < room;
}

extern "C" enum err_code image_read_info(const char *path, uint32_t *width_px, uint32_t *height_px,
                                         struct image_gps *gps, struct drone_meta *drone,
                                         struct err *e)
try {
    enum err_code rc = ERR_OK;
    std::unique_ptr<OIIO::ImageInput> in = image_open_input(path, &rc, e);
    if (!in)
        return rc;
    if (width_px)
        *width_px = (uint32_t)in->spec().width;
    if (height_px)
        *height_px = (uint32_t)in->spec().height;
    if (drone)
        drone_read(image_attribute, &in->spec(), drone);
    return gps ? exif_read(path, gps, e) : ERR_OK;
}
SHIM_CATCH("image_read_info", ERR_FORMAT)

static int image_quality(int quality)
{
    return quality <= 0 ? 95 : quality > 100 ? 100 : quality;
}

static OIIO::ImageSpec image_output_spec(const struct image *img, int quality)
{
    OIIO::ImageSpec s((int)img->width_px, (int)img->height_px, (int)img->channels,
                      OIIO::TypeDesc::UINT8);
    int q = image_quality(quality);
    s.attribute("CompressionQuality", q);
    if (q >= JPEG_FULL_CHROMA_QUALITY)
        s.attribute("jpeg:subsampling", "4:4:4");
    s.attribute("oiio:ColorSpace", "sRGB");
    return s;
}

static enum err_code image_write_pixels(OIIO::ImageOutput *o, const char *name,
                                        const struct image *img, int quality, struct err *e)
{
    if (!o)
        return err_set(e, ERR_ARG, "image : %s : cannot be written (%s)", name,
                       image_first_line(OIIO::geterror()).c_str());
    if (!o->open(name, image_output_spec(img, quality)) ||
        !o->write_image(OIIO::TypeDesc::UINT8, img->px) || !o->close())
        return err_set(e, ERR_LIMIT, "image : %u x %u as %s : %s", img->width_px, img->height_px,
                       name, image_first_line(o->geterror()).c_str());
    return ERR_OK;
}

extern "C" enum err_code image_encode(const struct image *img, const char *format, int quality,
                                      struct buf *out, struct err *e)
try {
    if (!strcmp(format, "png"))
        return png_encode(img->px, img->width_px, img->height_px, img->channels, out, e);
    if (!strcmp(format, "webp") && img->channels >= 3)
        return webp_encode(img->px, img->width_px, img->height_px, img->channels,
                           image_quality(quality), out, e);
    image_single_thread();
    std::vector<unsigned char> bytes;
    OIIO::Filesystem::IOVecOutput file(bytes);
    std::unique_ptr<OIIO::ImageOutput> o = OIIO::ImageOutput::create(format, &file);
    enum err_code rc = image_write_pixels(o.get(), format, img, quality, e);
    if (rc)
        return rc;
    buf_add(out, bytes.data(), bytes.size());
    return buf_check(out, e);
}
SHIM_CATCH("image_encode", ERR_INTERNAL)

// image_write_pixels, whose exceptions end here: there is a file to take away.
static enum err_code image_write_tiff(const char *part, const struct image *img,
                                      struct err *e) noexcept
try {
    image_single_thread();
    return image_write_pixels(OIIO::ImageOutput::create("tif").get(), part, img, 0, e);
}
SHIM_CATCH("image_write", ERR_INTERNAL)

// libtiff seeks while it writes, which OpenImageIO's memory file does not survive: by way of the
// disk.
static enum err_code image_encode_tiff(const char *path, const struct image *img, struct buf *out,
                                       struct err *e)
{
    char part[FILE_PATH_MAX];
    enum err_code rc = file_begin(path, part, e);
    if (rc)
        return rc;
    rc = image_write_tiff(part, img, e);
    if (!rc)
        rc = file_read(part, 0, out, e);
    file_abort(part);
    return rc;
}

extern "C" enum err_code image_write(const char *path, const struct image *img, int quality,
                                     const struct image_gps *gps, struct err *e)
try {
    const char *dot = strrchr(path, '.');
    const char *format = NULL;
    for (const char *known : {"jpg", "png", "webp", "tif"})
        if (dot && (!strcasecmp(dot + 1, known)))
            format = known;
    if (dot && !strcasecmp(dot + 1, "jpeg"))
        format = "jpg";
    if (dot && !strcasecmp(dot + 1, "tiff"))
        format = "tif";
    if (!format)
        return err_set(e, ERR_ARG, "image : %s : the name must end in .jpg .png .webp or .tif",
                       path);
    struct buf b = {};
    enum err_code rc = strcmp(format, "tif") ? image_encode(img, format, quality, &b, e)
                                             : image_encode_tiff(path, img, &b, e);
    if (!rc && gps)
        rc = exif_insert(&b, gps, e);
    if (!rc)
        rc = file_write(path, b.data, b.size, e);
    else
        err_add(e, "%s", path);
    buf_free(&b);
    return rc;
}
SHIM_CATCH("image_write", ERR_INTERNAL)
