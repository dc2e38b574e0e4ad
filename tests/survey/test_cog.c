/* Orthophotos, surface models and maps of change, as GDAL judges them: its validator of Cloud
 * Optimized GeoTIFF (osgeo_utils' samples, leader and trailer of every block), the output of
 * gdalinfo, and overviews that are means of their pixels.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/survey/survey_kit.h"

#include <stdlib.h>

#include <gdal/gdal.h>
#include <jansson.h>

#include "core/device/dev.h"
#include "survey/geotiff.h"

static const struct row {
    const char *name, *command;
    int epsg;
    size_t height; /* bands of heights and their uncertainty; 0: colours */
} rows[] = {
    {"ortho.tif", "ortho -q city.tiles -o ortho.tif --gsd-m 0.05", 32632, 0},
    {"dsm.tif", "dsm -q city.tiles -o dsm.tif --gsd-m 0.05", 32632, 2},
    {"mercator.tif", "ortho -q city.tiles -o mercator.tif --gsd-m 0.1 --epsg 3857", 3857, 0},
    {"gauss.tif", "dsm -q city.tiles -o gauss.tif --gsd-m 0.0625 --epsg 25832", 25832, 2},
    {"small.tif", "dsm -q city.tiles -o small.tif --gsd-m 1", 32632, 2},
    {"strip.tif",
     "ortho -q city.tiles -o strip.tif --gsd-m 0.05 --bbox 8.681,50.1109,8.683,50.1111", 32632, 0},
    {"change.tif", "compare -q city.tiles city.tiles -o change.tif --gsd-m 0.1", 32632, 2},
};

static int cog_setup(void **state)
{
    struct err e = {0};
    struct dev dev;
    survey_make(NULL);
    if (dev_open("cpu", &dev, &e) != ERR_OK) {
        print_message("skipped: %s\n", e.msg);
        return 0;
    }
    dev_close(&dev);
    const char *bin = getenv("CITYSPLAT_BIN");
    for (size_t i = 0; bin && i < sizeof rows / sizeof *rows; i++) {
        struct buf out = {0};
        if (kit_run(&out, "cd '%s' && '%s' %s", f.dir, bin, rows[i].command))
            fail_msg("%s: %.*s", rows[i].command, (int)out.size, (const char *)out.data);
        buf_free(&out);
    }
    return 0;
}

static void needs_maps(void)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    kit_ok(file_join(path, f.dir, rows[0].name, &e), e);
    if (!file_exists(path))
        skip();
}

/* Neither an error nor a warning. */
static void gdals_validator_finds_nothing(void **state)
{
    static const char module[] = "osgeo_utils.samples.validate_cloud_optimized_geotiff";
    static const char *const pythons[] = {"python3",
                                          "/usr/bin/python3"}; /* Debian's is the latter */
    const char *python = NULL;
    struct buf out = {0};
    needs_maps();
    for (size_t i = 0; !python && i < 2; i++) {
        python = kit_run(&out, "%s -c 'import %s'", pythons[i], module) ? NULL : pythons[i];
        buf_free(&out);
    }
    if (!python) {
        print_message("skipped: no %s (Debian's package python3-gdal has it)\n", module);
        skip();
    }
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        int rc = kit_run(&out, "cd '%s' && %s -m %s --full-check=yes %s", f.dir, python, module,
                         rows[i].name);
        buf_u8(&out, 0);
        const char *said = (const char *)out.data;
        if (rc || !strstr(said, "is a valid cloud optimized GeoTIFF") || strstr(said, "warning"))
            fail_msg("%s: %s", rows[i].name, said);
        buf_free(&out);
    }
    /* It does find something in what is none. */
    assert_int_equal(kit_run(&out,
                             "cd '%s' && gdal_translate -q dsm.tif plain.tif && %s -m %s "
                             "--full-check=yes plain.tif",
                             f.dir, python, module),
                     1);
    buf_free(&out);
}

static json_t *info(const char *name)
{
    struct buf out = {0};
    assert_int_equal(kit_run(&out, "cd '%s' && gdalinfo -json %s", f.dir, name), 0);
    json_t *o = json_loadb((const char *)out.data, out.size, 0, NULL);
    assert_non_null(o);
    buf_free(&out);
    return o;
}

static const char *text_at(const json_t *o, const char *key, const char *domain)
{
    return json_string_value(
        json_object_get(json_object_get(json_object_get(o, "metadata"), domain), key));
}

/* Each half as large as the one before, down to one tile of 512 px. */
static void overviews_halve(const char *name, const json_t *o)
{
    const json_t *size = json_object_get(o, "size"),
                 *all =
                     json_object_get(json_array_get(json_object_get(o, "bands"), 0), "overviews");
    json_int_t w = json_integer_value(json_array_get(size, 0)),
               h = json_integer_value(json_array_get(size, 1));
    size_t i = 0;
    for (; w > 512 || h > 512; i++) {
        const json_t *one = json_object_get(json_array_get(all, i), "size");
        json_int_t ow = json_integer_value(json_array_get(one, 0)),
                   oh = json_integer_value(json_array_get(one, 1));
        if (!one || llabs(2 * ow - w) > 1 || llabs(2 * oh - h) > 1)
            fail_msg("%s: overview %zu of %d x %d px after %d x %d", name, i, (int)ow, (int)oh,
                     (int)w, (int)h);
        w = ow;
        h = oh;
    }
    assert_int_equal(json_array_size(all), i);
}

static void gdalinfo_says_what_it_is(void **state)
{
    size_t n_overviews = 0;
    needs_maps();
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        json_t *o = info(rows[i].name), *bands = json_object_get(o, "bands"),
               *band = json_array_get(bands, 0);
        struct buf out = {0};
        char want[32];
        assert_string_equal(text_at(o, "LAYOUT", "IMAGE_STRUCTURE"), "COG");
        assert_string_equal(text_at(o, "COMPRESSION", "IMAGE_STRUCTURE"), "DEFLATE");
        assert_string_equal(text_at(o, "TIFFTAG_COPYRIGHT", ""), "ours");
        assert_int_equal(json_array_size(bands), rows[i].height ? rows[i].height : 4);
        assert_int_equal(json_integer_value(json_array_get(json_object_get(band, "block"), 0)),
                         512);
        assert_string_equal(json_string_value(json_object_get(band, "type")),
                            rows[i].height ? "Float32" : "Byte");
        if (rows[i].height)
            assert_true(json_number_value(json_object_get(band, "noDataValue")) ==
                        (double)GEOTIFF_NODATA);
        else
            assert_string_equal(
                json_string_value(json_object_get(json_array_get(bands, 3), "colorInterpretation")),
                "Alpha");
        overviews_halve(rows[i].name, o);
        n_overviews += json_array_size(json_object_get(band, "overviews"));
        json_decref(o);
        snprintf(want, sizeof want, "EPSG:%d", rows[i].epsg);
        assert_int_equal(kit_run(&out, "cd '%s' && gdalsrsinfo -o epsg %s", f.dir, rows[i].name),
                         0);
        buf_u8(&out, 0);
        kit_expect_text((const char *)out.data, want, __FILE__, __LINE__);
        buf_free(&out);
    }
    assert_true(n_overviews >= 8);
}

/* A pixel of the first overview is the mean of its four, of which nodata is none. */
static void overviews_are_means(void **state)
{
    struct err e = {0};
    needs_maps();
    kit_ok(geotiff_start(&e), e);
    for (size_t i = 0; i < 2; i++) {
        char path[FILE_PATH_MAX];
        kit_ok(file_join(path, f.dir, rows[i].name, &e), e);
        GDALDatasetH d = GDALOpen(path, GA_ReadOnly);
        assert_non_null(d);
        GDALRasterBandH full = GDALGetRasterBand(d, 1), half = GDALGetOverview(full, 0),
                        alpha = i ? NULL : GDALGetRasterBand(d, 4);
        int w = GDALGetRasterBandXSize(half), h = GDALGetRasterBandYSize(half);
        float *small = mem_array((size_t)w * (size_t)h, sizeof *small),
              *large = mem_array((size_t)w * (size_t)h, 4 * sizeof *large),
              *seen = mem_array((size_t)w * (size_t)h, 4 * sizeof *seen);
        size_t n = 0, off = 0;
        assert_true(small && large && seen);
        assert_int_equal(GDALRasterIO(half, GF_Read, 0, 0, w, h, small, w, h, GDT_Float32, 0, 0),
                         CE_None);
        int even_w = 2 * (GDALGetRasterXSize(d) / 2), even_h = 2 * (GDALGetRasterYSize(d) / 2);
        assert_true(even_w == GDALGetRasterXSize(d) && even_h == GDALGetRasterYSize(d));
        assert_int_equal(GDALRasterIO(full, GF_Read, 0, 0, even_w, even_h, large, even_w, even_h,
                                      GDT_Float32, 0, 0),
                         CE_None);
        if (alpha)
            assert_int_equal(GDALRasterIO(alpha, GF_Read, 0, 0, even_w, even_h, seen, even_w,
                                          even_h, GDT_Float32, 0, 0),
                             CE_None);
        for (int y = 0; y < even_h / 2; y++)
            for (int x = 0; x < even_w / 2; x++) {
                float sum = 0;
                int held = 0;
                for (int k = 0; k < 4; k++) {
                    int at = (2 * y + k / 2) * even_w + 2 * x + k % 2;
                    bool in = alpha ? seen[at] > 0 : large[at] > -9000;
                    sum += in ? large[at] : 0;
                    held += in;
                }
                float got = small[y * w + x];
                if (!held && !alpha)
                    off += got != GEOTIFF_NODATA;
                if (held != 4)
                    continue;
                n++;
                off += fabsf(got - sum / 4) > (alpha ? 0.51f : 1e-3f);
            }
        printf("cog: %zu px of the first overview of %s, %zu wrong\n", n, rows[i].name, off);
        assert_true(n > 100000);
        assert_int_equal(off, 0);
        GDALClose(d);
        mem_free(small);
        mem_free(large);
        mem_free(seen);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(gdals_validator_finds_nothing),
        cmocka_unit_test(gdalinfo_says_what_it_is),
        cmocka_unit_test(overviews_are_means),
    };
    return cmocka_run_group_tests_name("cog", tests, cog_setup, survey_teardown);
}
