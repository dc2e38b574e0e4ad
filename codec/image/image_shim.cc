// OpenImageIO behind the table of image_library.h: a library of its own, loaded by image.c.
//
// OpenImageIO runs single-threaded here: callers work on many images at once, and results must not
// depend on a thread count.
//
// SPDX-License-Identifier: Apache-2.0
#include "codec/image/image.h"
#include "codec/image/image_library.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <cstdio>
#include <memory>
#include <new>
#include <string>
#include <vector>

static constexpr int JPEG_FULL_CHROMA_QUALITY = 95; // from here on chroma is not subsampled

struct image_input {
    std::unique_ptr<OIIO::ImageInput> file;
};

static void image_single_thread()
{
    static const bool once = OIIO::attribute("threads", 1);
    (void)once;
}

// Messages may span lines; the first one is enough for ours.
static enum err_code image_fail(struct image_why *why, enum err_code code, const std::string &text)
{
    std::string line = text.substr(0, text.find('\n'));
    snprintf(why->text, sizeof why->text, "%s", line.empty() ? "unknown reason" : line.c_str());
    return code;
}

// The end of each function: no exception leaves it.
#define IMAGE_CATCH(code)                                                                          \
    catch (const std::bad_alloc &)                                                                 \
    {                                                                                              \
        return image_fail(why, ERR_MEM, "out of memory");                                          \
    }                                                                                              \
    catch (const std::exception &x)                                                                \
    {                                                                                              \
        return image_fail(why, code, x.what());                                                    \
    }                                                                                              \
    catch (...)                                                                                    \
    {                                                                                              \
        return image_fail(why, ERR_INTERNAL, "unknown exception");                                 \
    }

static enum err_code image_open(const char *path, struct image_input **in, struct image_spec *spec,
                                struct image_why *why)
try {
    image_single_thread();
    OIIO::ImageSpec config;
    config.attribute("oiio:UnassociatedAlpha", 1); // colours as stored, not multiplied by alpha
    std::unique_ptr<image_input> opened(new image_input);
    opened->file = OIIO::ImageInput::open(path, &config);
    if (!opened->file)
        return image_fail(why, ERR_FORMAT, OIIO::geterror());
    const OIIO::ImageSpec &s = opened->file->spec();
    *spec = {s.width, s.height, s.depth, s.nchannels, s.alpha_channel};
    *in = opened.release();
    return ERR_OK;
}
IMAGE_CATCH(ERR_FORMAT)

static void image_close(struct image_input *in)
{
    delete in;
}

static enum err_code image_read_u8(struct image_input *in, int first, int take, uint8_t *px,
                                   struct image_why *why)
try {
    bool ok = in->file->read_image(0, 0, first, first + take, OIIO::TypeDesc::UINT8, px, 3);
    std::string text = in->file->geterror();
    return ok && text.empty() ? ERR_OK : image_fail(why, ERR_FORMAT, text);
}
IMAGE_CATCH(ERR_FORMAT)

static enum err_code image_read_float(struct image_input *in, float *px, struct image_why *why)
try {
    bool ok = in->file->read_image(0, 0, 0, 1, OIIO::TypeDesc::FLOAT, px);
    std::string text = in->file->geterror();
    return ok && text.empty() ? ERR_OK : image_fail(why, ERR_FORMAT, text);
}
IMAGE_CATCH(ERR_FORMAT)

static OIIO::ImageSpec image_output_spec(const struct image *img, int quality)
{
    OIIO::ImageSpec s((int)img->width_px, (int)img->height_px, (int)img->channels,
                      OIIO::TypeDesc::UINT8);
    s.attribute("CompressionQuality", quality);
    if (quality >= JPEG_FULL_CHROMA_QUALITY)
        s.attribute("jpeg:subsampling", "4:4:4");
    s.attribute("oiio:ColorSpace", "sRGB");
    return s;
}

static enum err_code image_write_pixels(OIIO::ImageOutput *o, const char *name,
                                        const struct image *img, int quality, struct image_why *why)
{
    if (!o)
        return image_fail(why, ERR_ARG, OIIO::geterror());
    if (!o->open(name, image_output_spec(img, quality)) ||
        !o->write_image(OIIO::TypeDesc::UINT8, img->px) || !o->close())
        return image_fail(why, ERR_LIMIT, o->geterror());
    return ERR_OK;
}

static enum err_code image_encode_memory(const struct image *img, const char *format, int quality,
                                         void (*add)(void *, const void *, size_t), void *to,
                                         struct image_why *why)
try {
    image_single_thread();
    std::vector<unsigned char> bytes;
    OIIO::Filesystem::IOVecOutput file(bytes);
    std::unique_ptr<OIIO::ImageOutput> o = OIIO::ImageOutput::create(format, &file);
    enum err_code rc = image_write_pixels(o.get(), format, img, quality, why);
    if (!rc)
        add(to, bytes.data(), bytes.size());
    return rc;
}
IMAGE_CATCH(ERR_INTERNAL)

static enum err_code image_write_tiff(const char *path, const struct image *img,
                                      struct image_why *why)
try {
    image_single_thread();
    return image_write_pixels(OIIO::ImageOutput::create("tif").get(), path, img, 95, why);
}
IMAGE_CATCH(ERR_INTERNAL)

extern "C" const struct image_library image_library_table;
const struct image_library image_library_table = {
    IMAGE_LIBRARY_VERSION, image_open,          image_close,     image_read_u8,
    image_read_float,      image_encode_memory, image_write_tiff};
