/* Reads XMP packets: simple properties by name, in whatever form XML gives them. Expat parses.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_XMP_H
#define CODEC_XMP_H

#include <stdbool.h>
#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { XMP_VALUES = 96, XMP_NAME = 48, XMP_TEXT = 64, XMP_BYTES_MAX = 16 << 20 };
struct xmp { /* {0} is empty */
    struct {
        char name[XMP_NAME], text[XMP_TEXT];
    } value[XMP_VALUES];
    size_t n;
};
/* Adds the properties of a packet of drones, of Pix4D and of EXIF; of two of one name the first
 * stays. They may be attributes or elements, and have any prefix: "drone-dji:RelativeAltitude"
 * means the property of that name in DJI's namespace. A member of a structure has the name of both:
 * "drone-skydio:CameraOrientationNED/Pitch". Longer texts than XMP_TEXT and document types
 * are left out. Of a packet that is no XML, the values that stand in it are read. Any thread. */
void xmp_add(struct xmp *x, const void *packet, size_t n);
/* Adds photo.xmp and photo.JPG.xmp beside photo.JPG, `path`: the name as it is, in small letters or
 * in capitals. */
void xmp_add_sidecars(struct xmp *x, const char *path);
/* Writes the text of a property without blanks around it; `xmp` is a struct xmp. Returns false if
 * there is none, or no room. */
bool xmp_get(const void *xmp, const char *name, char *text, size_t room);

#ifdef __cplusplus
}
#endif
#endif
