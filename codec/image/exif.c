/* Position, time and exposure of photographs by EXIF.
 *
 * OpenImageIO reads EXIF's rationals into float32, which is a metre at the equator for cameras that
 * write decimal degrees, and its writer stores no GPS in PNG, WebP and TIFF (and 0.5" as infinity
 * in JPEG). So the dozen fields that georeferencing needs are read and written here: exif_parts.c
 * finds EXIF in a picture, tiff.c reads its fields, exif_insert.c writes them.
 *
 * Source: EXIF 2.32 (CIPA DC-008).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/exif.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "codec/image/drone.h"
#include "codec/image/exif_parts.h"
#include "codec/image/exif_tags.h"
#include "codec/image/tiff.h"
#include "codec/image/xmp.h"
#include "core/base.h"

/* The first letter of a text, in lower case; 0: none. */
static int exif_letter(const struct tiff *t, uint32_t ifd, unsigned tag)
{
    struct tiff_field f;
    if (tiff_find(t, ifd, tag, &f))
        for (size_t i = 0; i < f.n; i++)
            if (f.data[i] > ' ')
                return f.data[i] | 0x20;
    return 0;
}

/* Degrees, minutes and seconds. A fraction of one that the next repeats counts once. Minutes and
 * seconds that are missing or n/0 are 0; more than 60 are no angle. South and west are what either
 * the letter or a sign says. odd_sign: the letter says the other hemisphere. no_letter: none says
 * it. */
static bool exif_angle(const struct tiff *t, uint32_t ifd, unsigned tag, const char letters[2],
                       double *out, struct image_gps *g)
{
    struct tiff_field f;
    double part[3] = {0};
    if (!tiff_find(t, ifd, tag, &f) || !tiff_field_num(t, &f, 0, &part[0]))
        return false;
    for (size_t i = 1; i < 3; i++)
        if (!tiff_field_num(t, &f, i, &part[i]))
            part[i] = 0;
    const bool minus = part[0] < 0 || part[1] < 0 || part[2] < 0;
    for (size_t i = 0; i < 3; i++)
        part[i] = fabs(part[i]);
    if (fabs((part[0] - floor(part[0])) * 60 - part[1]) < 1 && part[0] > floor(part[0]))
        part[1] = part[2] = 0;
    if (fabs((part[1] - floor(part[1])) * 60 - part[2]) < 1 && part[1] > floor(part[1]))
        part[2] = 0;
    const int letter = exif_letter(t, ifd, tag - 1);
    *out = part[0] + part[1] / 60 + part[2] / 3600;
    g->odd_sign |= minus && letter && letter != letters[1];
    g->no_letter |= !minus && letter != letters[0] && letter != letters[1];
    if (minus || letter == letters[1])
        *out = -*out;
    return part[1] <= 60 && part[2] <= 60;
}

/* Longitudes may count to 360. 0, 0 is what cameras write without a fix. */
static void exif_position(const struct tiff *t, uint32_t gps, struct image_gps *out)
{
    double lat, lon;
    if (!exif_angle(t, gps, EXIF_GPS_LAT, "ns", &lat, out) ||
        !exif_angle(t, gps, EXIF_GPS_LON, "ew", &lon, out))
        return;
    lon = fabs(lon) > 180 && fabs(lon) <= 360 ? remainder(lon, 360) : lon;
    if (fabs(lat) > 90 || fabs(lon) > 180 || (lat == 0 && lon == 0))
        return;
    out->has_position = true;
    out->lat_deg = lat;
    out->lon_deg = lon;
}

/* Is GPSMapDatum one of those that lie tens of metres and more from WGS 84? */
static bool exif_far_datum(const struct tiff *t, uint32_t gps)
{
    static const char *const far[] = {"tokyo", "nad27",    "nad 27", "nad-27",  "ed50",
                                      "ed 50", "european", "osgb",   "pulkovo", "agd"};
    struct tiff_field f;
    char low[32] = "";
    if (!tiff_find(t, gps, EXIF_GPS_DATUM, &f) || f.type != TIFF_ASCII)
        return false;
    for (size_t i = 0; i < f.count && f.data[i] && i + 1 < sizeof low; i++)
        low[i] = (char)(f.data[i] >= 'A' && f.data[i] <= 'Z' ? f.data[i] | 0x20 : f.data[i]);
    for (size_t k = 0; k < sizeof far / sizeof *far; k++)
        if (strstr(low, far[k]))
            return true;
    return false;
}

/* EXIF 3.0: 0 above, 1 below the sea; 2 above, 3 below the ellipsoid. Some write the digit. */
static void exif_altitude(const struct tiff *t, uint32_t gps, struct image_gps *out)
{
    struct tiff_field f;
    double ref = 0;
    if (!tiff_find(t, gps, EXIF_GPS_ALT, &f) || !tiff_field_num(t, &f, 0, &out->alt_m))
        return;
    out->has_altitude = true;
    if (!tiff_find(t, gps, EXIF_GPS_ALT_REF, &f))
        return;
    if (!tiff_field_num(t, &f, 0, &ref))
        ref = f.data[0];
    ref = ref >= '0' && ref <= '3' ? ref - '0' : ref;
    out->ellipsoidal = ref == 2 || ref == 3;
    if (ref == 1 || ref == 3)
        out->alt_m = -fabs(out->alt_m);
}

/* The fields and the packets of a picture. */
static void exif_fields(const struct exif_parts *x, struct image_gps *out, struct xmp *xmp)
{
    struct tiff t;
    uint32_t ifd0;
    for (size_t i = 0; xmp && i < x->n_packets; i++)
        xmp_add(xmp, x->packet[i].p, x->packet[i].n);
    if (!x->exif.p || !tiff_open(x->exif.p, x->exif.n, &t, &ifd0))
        return;
    const uint32_t exif = tiff_offset(&t, ifd0, EXIF_TAG_IFD);
    const uint32_t gps = tiff_offset(&t, ifd0, EXIF_TAG_GPS_IFD);
    out->exposure_s = tiff_num(&t, exif, EXIF_TAG_EXPOSURE);
    out->iso = tiff_num(&t, exif, EXIF_TAG_ISO);
    out->focal_mm = tiff_num(&t, exif, EXIF_TAG_FOCAL);
    tiff_text(&t, exif, EXIF_TAG_DATE_ORIGINAL, out->time, sizeof out->time);
    exif_position(&t, gps, out);
    exif_altitude(&t, gps, out);
    out->interrupted = exif_letter(&t, gps, EXIF_GPS_STATUS) == 'v';
    out->far_datum = exif_far_datum(&t, gps);
}

void exif_parse(const void *bytes, size_t n, struct image_gps *out, struct xmp *xmp)
{
    struct exif_parts x = {0};
    *out = (struct image_gps){0};
    exif_parts_find(bytes, n, &x);
    exif_fields(&x, out, xmp);
    exif_parts_free(&x);
}

enum err_code exif_read(const char *path, struct image_gps *gps, struct drone_meta *drone,
                        struct err *e)
{
    struct exif_parts x = {0};
    struct xmp *xmp = mem_array(1, sizeof *xmp);
    *gps = (struct image_gps){0};
    *drone = (struct drone_meta){0};
    enum err_code rc =
        xmp ? exif_parts_read(path, &x, e) : err_set(e, ERR_MEM, "exif: %s: out of memory", path);
    if (!rc) {
        exif_fields(&x, gps, xmp);
        xmp_add_sidecars(xmp, path);
        drone_read(xmp_get, xmp, drone);
    }
    mem_free(xmp);
    exif_parts_free(&x);
    return rc;
}
