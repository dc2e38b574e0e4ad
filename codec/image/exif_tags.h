/* The fields of EXIF that are read and written here: EXIF 2.32 (CIPA DC-008), and TIFF 6.0.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CODEC_EXIF_TAGS_H
#define CODEC_EXIF_TAGS_H

enum {
    EXIF_TAG_MAKE = 0x010f,
    EXIF_TAG_MODEL = 0x0110,
    EXIF_TAG_XMP = 0x02bc,
    EXIF_TAG_EXPOSURE = 0x829a,
    EXIF_TAG_IFD = 0x8769, /* where the Exif directory is */
    EXIF_TAG_GPS_IFD = 0x8825,
    EXIF_TAG_ISO = 0x8827,
    EXIF_TAG_DATE_ORIGINAL = 0x9003,
    EXIF_TAG_FOCAL = 0x920a,
    EXIF_TAG_FOCAL_35MM = 0xa405
};
enum { /* of the GPS directory */
       EXIF_GPS_VERSION = 0,
       EXIF_GPS_LAT_REF = 1,
       EXIF_GPS_LAT = 2,
       EXIF_GPS_LON_REF = 3,
       EXIF_GPS_LON = 4,
       EXIF_GPS_ALT_REF = 5,
       EXIF_GPS_ALT = 6,
       EXIF_GPS_STATUS = 9,
       EXIF_GPS_DATUM = 0x12
};

#endif
