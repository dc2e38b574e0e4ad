/* core/device/dev.c: choosing a device, building programs with errors people can read, buffers and
 * their limits.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "core/device/dev.h"
#include "core/device/programs.h"
#include "core/layout.h"

static const char DOUBLE_CL[] = "__kernel void double_it(__global float *x, uint n)\n"
                                "{\n"
                                "    uint i = get_global_id(0);\n"
                                "    if (i < n)\n"
                                "        x[i] = 2.0f * x[i] + (float)(VW - VW);\n"
                                "}\n";
static const char BROKEN_CL[] =
    "__kernel void broken(__global float *x)\n{\n    x[0] = no_such_name;\n}\n";

static int setup(void **state)
{
    static struct dev d;
    struct err e = {0};
    if (dev_open(NULL, &d, &e) != ERR_OK) {
        print_error("%s\n", e.msg);
        return 1;
    }
    *state = &d;
    return 0;
}

static int teardown(void **state)
{
    dev_close(*state);
    dev_close(*state); /* idempotent */
    return 0;
}

static void test_open_describes_the_device(void **state)
{
    const struct dev *d = *state;
    assert_true(d->name[0] != '\0');
    assert_true(d->max_alloc_bytes >= (1u << 27)); /* the minimum an OpenCL 1.2 device may offer */
    assert_true(d->global_bytes >= d->max_alloc_bytes);
    assert_int_equal(d->vector_width, d->is_cpu ? 16 : 1);
}

static void test_open_by_name(void **state)
{
    const struct dev *d = *state;
    struct dev again;
    struct err e = {0};
    char part[8] = "";
    memcpy(part, d->name, 6);
    assert_int_equal(dev_open(part, &again, &e), ERR_OK);
    assert_string_equal(again.name, d->name);
    dev_close(&again);
    assert_int_equal(dev_open("no such device", &again, &e), ERR_DEVICE);
    assert_non_null(strstr(e.msg, "no such device"));
    assert_non_null(strstr(e.msg, d->name)); /* says what there is */
    assert_null(again.context);
}

static void test_build_and_run(void **state)
{
    struct dev *d = *state;
    struct err e = {0};
    enum { N = 1000 };
    float x[N];
    cl_uint n = N;
    cl_program p = NULL;
    cl_kernel k = NULL;
    cl_mem m = NULL;
    const struct dev_source src = {"tests/double.cl", DOUBLE_CL};
    for (int i = 0; i < N; i++)
        x[i] = (float)i;
    assert_int_equal(dev_build(d, &src, 1, "-DUNUSED=1", &p, &e), ERR_OK);
    assert_int_equal(dev_kernel(p, "double_it", &k, &e), ERR_OK);
    assert_int_equal(dev_buffer(d, sizeof x, x, &m, &e), ERR_OK);
    assert_int_equal(dev_arg(k, 0, m), CL_SUCCESS);
    assert_int_equal(dev_arg(k, 1, n), CL_SUCCESS);
    assert_int_equal(dev_run(d, k, "double_it", N, 64, &e), ERR_OK); /* 1000 is no multiple of 64 */
    assert_int_equal(dev_run(d, k, "double_it", 0, 64, &e), ERR_OK); /* nothing to do */
    assert_int_equal(dev_finish(d, &e), ERR_OK);
    assert_int_equal(dev_read(d, m, 0, sizeof x, x, &e), ERR_OK);
    for (int i = 0; i < N; i++)
        assert_true(x[i] == 2.0f * (float)i);

    struct { /* zero an odd range in the middle, bytewise */
        size_t at, n;
    } hole = {41, 101};
    unsigned char bytes[sizeof x];
    assert_int_equal(dev_zero(d, m, hole.at, hole.n, &e), ERR_OK);
    assert_int_equal(dev_read(d, m, 0, sizeof bytes, bytes, &e), ERR_OK);
    for (size_t i = 0; i < sizeof bytes; i++) {
        unsigned char want = ((const unsigned char *)x)[i];
        assert_int_equal(bytes[i], i >= hole.at && i < hole.at + hole.n ? 0 : want);
    }
    void *seen = NULL; /* the host writes into the buffer, and the device has it */
    assert_int_equal(dev_map(d, m, CL_MAP_READ | CL_MAP_WRITE, sizeof x, &seen, &e), ERR_OK);
    assert_memory_equal(seen, bytes, sizeof bytes);
    ((float *)seen)[N - 1] = 0.25f;
    assert_int_equal(dev_unmap(d, m, &seen, &e), ERR_OK);
    assert_null(seen);
    assert_int_equal(dev_unmap(d, m, &seen, &e), ERR_OK); /* nothing to give back */
    assert_int_equal(dev_run(d, k, "double_it", N, 64, &e), ERR_OK);
    assert_int_equal(dev_read(d, m, 0, sizeof x, x, &e), ERR_OK);
    assert_true(x[N - 1] == 0.5f);
    assert_int_equal(dev_map(d, m, CL_MAP_READ, 2 * sizeof x, &seen, &e), ERR_DEVICE);
    assert_null(seen);
    clReleaseKernel(k);
    assert_int_equal(dev_kernel(p, "no_such_kernel", &k, &e), ERR_DEVICE);
    assert_null(k);
    assert_non_null(strstr(e.msg, "no_such_kernel"));
    dev_release(&m);
    dev_release(&m);
    dev_release(NULL);
    clReleaseProgram(p);
}

static void test_unset_argument_is_an_error(void **state)
{
    struct dev *d = *state;
    struct err e = {0};
    cl_program p = NULL;
    cl_kernel k = NULL;
    const struct dev_source src = {"tests/double.cl", DOUBLE_CL};
    assert_int_equal(dev_build(d, &src, 1, NULL, &p, &e), ERR_OK);
    assert_int_equal(dev_kernel(p, "double_it", &k, &e), ERR_OK);
    assert_int_equal(dev_run(d, k, "double_it", 64, 64, &e), ERR_DEVICE);
    assert_non_null(strstr(e.msg, "double_it"));
    clReleaseKernel(k);
    clReleaseProgram(p);
}

static void test_build_error_cites_file_and_line(void **state)
{
    struct dev *d = *state;
    struct err e = {0};
    cl_program p = NULL;
    const struct dev_source src[2] = {{"tests/double.cl", DOUBLE_CL},
                                      {"tests/broken.cl", BROKEN_CL}};
    assert_int_equal(dev_build(d, src, 2, NULL, &p, &e), ERR_DEVICE);
    assert_null(p);
    kit_expect_text(e.msg, "tests/broken.cl:3", __FILE__, __LINE__);
    kit_expect_text(e.msg, "no_such_name", __FILE__, __LINE__);
}

/* As NVIDIA's driver writes its logs. */
static void test_lines_of_all_pieces_are_those_of_files(void **state)
{
    const char *const text[] = {"\n#line 1 \"a.h\"\n", "one\ntwo\n", "\n#line 1 \"b.cl\"\n",
                                "one\ntwo\nthree"},
                      *const names[] = {"a.h", "b.cl"};
    struct buf got = {0};
    dev_cite("<kernel>:4:2: error: x\n<kernel>:9:12: note: y\n<kernel>:1:1: z <kernel>:99:1: w",
             text, names, 4, &got);
    assert_string_equal((const char *)got.data,
                        "a.h:2:2: error: x\nb.cl:3:12: note: y\n<kernel>:1:1: z <kernel>:99:1: w");
    buf_free(&got);
}

/* double_it on n floats. */
static void open_double(struct dev *d, cl_uint n, cl_program *p, cl_kernel *k, cl_mem *m)
{
    struct err e = {0};
    const struct dev_source src = {"tests/double.cl", DOUBLE_CL};
    kit_ok(dev_build(d, &src, 1, NULL, p, &e), e);
    kit_ok(dev_kernel(*p, "double_it", k, &e), e);
    kit_ok(dev_buffer(d, n * sizeof(float), NULL, m, &e), e);
    assert_int_equal(dev_arg(*k, 0, *m) | dev_arg(*k, 1, n), CL_SUCCESS);
}

/* Launches are counted by name, on the device's clock, and the queue is as before afterwards. */
static void test_kernels_are_timed_by_name(void **state)
{
    struct dev *d = *state;
    struct err e = {0};
    cl_program p = NULL;
    cl_kernel k = NULL;
    cl_mem m = NULL;
    const cl_uint n = 1 << 16;
    float x = 1, got = 0;
    struct dev_time times[2];
    size_t n_times = 0;
    cl_command_queue plain = d->queue;
    open_double(d, n, &p, &k, &m);
    kit_ok(dev_write(d, m, 0, sizeof x, &x, &e), e);
    kit_ok(dev_run(d, k, "before", n, 64, &e), e);
    kit_ok(dev_time_begin(d, &e), e);
    kit_ok(dev_run(d, k, "one", n, 64, &e), e);
    kit_ok(dev_run(d, k, "two", n, 64, &e), e);
    kit_ok(dev_run(d, k, "one", n, 64, &e), e);
    kit_ok(dev_run(d, k, "three", n, 64, &e), e); /* no room for it */
    kit_ok(dev_time_end(d, times, 2, &n_times, &e), e);
    kit_ok(dev_run(d, k, "after", n, 64, &e), e);
    assert_ptr_equal(d->queue, plain);
    assert_int_equal(n_times, 2);
    assert_string_equal(times[0].name, "one");
    assert_int_equal(times[0].launches, 2);
    assert_string_equal(times[1].name, "two");
    assert_int_equal(times[1].launches, 1);
    assert_true(times[0].ms > 0 && times[1].ms > 0);
    assert_true(times[0].core_ms == 0);
    kit_ok(dev_time_begin(d, &e), e); /* in processor time, too */
    dev_time_cores(d);
    kit_ok(dev_run(d, k, "one", n, 64, &e), e);
    kit_ok(dev_time_end(d, times, 2, &n_times, &e), e);
    assert_true(n_times == 1 && times[0].ms > 0);
    assert_true(d->is_cpu ? times[0].core_ms > 0 : times[0].core_ms == 0);
    kit_ok(dev_read(d, m, 0, sizeof got, &got, &e), e);
    assert_true(got == 128.0f);
    dev_release(&m);
    clReleaseKernel(k);
    clReleaseProgram(p);
}

/* Without waiting, commands still act in their order, and a read waits for its own turn alone. */
static void test_hand_over_without_waiting(void **state)
{
    struct dev *d = *state;
    struct err e = {0};
    cl_program p = NULL;
    cl_kernel k = NULL;
    cl_mem m = NULL;
    const cl_uint n = 1;
    const float in[2] = {3, 10};
    float got[2] = {0}, last = 0;
    struct dev_pending first = {0}, second = {0}, bad = {0};
    open_double(d, n, &p, &k, &m);
    kit_ok(dev_wait(d, &first, &e), e); /* nothing is pending */
    kit_ok(dev_write_soon(d, m, 0, sizeof *in, &in[0], &e), e);
    kit_ok(dev_run(d, k, "double_it", n, 1, &e), e);
    kit_ok(dev_read_soon(d, m, 0, sizeof *got, &got[0], &first, &e), e);
    kit_ok(dev_write_soon(d, m, 0, sizeof *in, &in[1], &e), e);
    kit_ok(dev_run(d, k, "double_it", n, 1, &e), e);
    kit_ok(dev_read_soon(d, m, 0, sizeof *got, &got[1], &second, &e), e);
    kit_ok(dev_run(d, k, "double_it", n, 1, &e), e);
    kit_ok(dev_wait(d, &second, &e), e);
    kit_ok(dev_wait(d, &first, &e), e);
    kit_ok(dev_wait(d, &first, &e), e);
    assert_true(got[0] == 6.0f && got[1] == 20.0f);
    kit_ok(dev_read(d, m, 0, sizeof last, &last, &e), e);
    assert_true(last == 40.0f);
    assert_int_equal(dev_read_soon(d, m, 1024, sizeof last, &last, &bad, &e), ERR_DEVICE);
    assert_int_equal(dev_write_soon(d, m, 1024, sizeof last, &last, &e), ERR_DEVICE);
    kit_ok(dev_wait(d, &bad, &e), e);
    kit_ok(dev_read_soon(d, m, 0, sizeof last, &last, &first, &e), e);
    dev_abandon(d, &first);
    assert_null(first.event);
    dev_abandon(d, NULL);
    dev_release(&m);
    clReleaseKernel(k);
    clReleaseProgram(p);
}

static void test_buffer_limits(void **state)
{
    struct dev *d = *state;
    struct err e = {0};
    cl_mem m = NULL;
    size_t size = 0;
    assert_int_equal(dev_buffer(d, (size_t)d->max_alloc_bytes + 1, NULL, &m, &e), ERR_LIMIT);
    assert_null(m);
    assert_int_equal(dev_buffer(d, SIZE_MAX, NULL, &m, &e), ERR_LIMIT);
    assert_int_equal(dev_buffer(d, 0, NULL, &m, &e), ERR_OK);
    assert_int_equal(clGetMemObjectInfo(m, CL_MEM_SIZE, sizeof size, &size, NULL), CL_SUCCESS);
    assert_int_equal(size, 64);
    dev_release(&m);
    assert_int_equal(dev_buffer(d, 65, NULL, &m, &e), ERR_OK);
    assert_int_equal(clGetMemObjectInfo(m, CL_MEM_SIZE, sizeof size, &size, NULL), CL_SUCCESS);
    assert_int_equal(size, 128);
    char past[1];
    assert_int_equal(dev_read(d, m, 128, 1, past, &e), ERR_DEVICE);
    dev_release(&m);
}

/* Builds DOUBLE_CL with the folder kit_tmp/programs, runs it on 3; says whether it was compiled. */
static bool double_it_compiles(const struct dev *with)
{
    struct dev d = *with;
    struct err e = {0};
    cl_program p = NULL;
    cl_kernel k = NULL;
    cl_mem m = NULL;
    const struct dev_source src = {"tests/double.cl", DOUBLE_CL};
    const cl_uint n = 1;
    float x = 3, got = 0;
    d.said_compiling = false;
    d.n_launched = 0;
    kit_ok(file_join(d.programs, kit_tmp, "programs", &e), e);
    kit_ok(dev_build(&d, &src, 1, NULL, &p, &e), e);
    kit_ok(dev_kernel(p, "double_it", &k, &e), e);
    kit_ok(dev_buffer(&d, sizeof x, &x, &m, &e), e);
    assert_int_equal(dev_arg(k, 0, m) | dev_arg(k, 1, n), CL_SUCCESS);
    kit_ok(dev_run(&d, k, "double_it", n, 1, &e), e);
    kit_ok(dev_read(&d, m, 0, sizeof got, &got, &e), e);
    assert_true(got == 6.0f);
    dev_release(&m);
    clReleaseKernel(k);
    clReleaseProgram(p);
    return d.said_compiling;
}

/* Changes the bytes of the only kept program, expects that it is compiled anew, and that the new
 * one is good. */
static void damaged_is_compiled(const struct dev *d, const char *path, const struct buf *good,
                                size_t n_bytes, size_t flip)
{
    struct err e = {0};
    struct buf bad = {0}, again = {0};
    buf_add(&bad, good->data, n_bytes);
    if (flip < bad.size)
        bad.data[flip] ^= 0x10;
    kit_ok(file_write(path, bad.data, bad.size, &e), e);
    assert_true(double_it_compiles(d));
    kit_ok(file_read(path, 0, &again, &e), e);
    assert_int_equal(again.size, good->size);
    assert_false(double_it_compiles(d));
    buf_free(&bad);
    buf_free(&again);
}

static void test_programs_are_kept(void **state)
{
    const struct dev *d = *state;
    struct err e = {0};
    struct arena a = {0};
    struct buf good = {0}, other = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], **names;
    size_t n = 0;
    kit_ok(file_join(dir, kit_tmp, "programs", &e), e);
    assert_true(programs_folder(dir));
    assert_true(double_it_compiles(d));
    kit_ok(file_list(dir, NULL, &a, &names, &n, &e), e);
    if (!d->is_pocl && n == 0)
        skip();
    assert_int_equal(n, 1);
    assert_false(double_it_compiles(d));

    kit_ok(file_join(path, dir, names[0], &e), e);
    kit_ok(file_read(path, 0, &good, &e), e);
    damaged_is_compiled(d, path, &good, 0, 0);
    damaged_is_compiled(d, path, &good, 20, 20);
    damaged_is_compiled(d, path, &good, good.size / 2, good.size);
    damaged_is_compiled(d, path, &good, good.size, 0);             /* another kind of file */
    damaged_is_compiled(d, path, &good, good.size, 8);             /* of another key */
    damaged_is_compiled(d, path, &good, good.size, good.size - 1); /* one bit of the program */

    /* A file that is whole, but no program of this driver. */
    struct hash128 key;
    memcpy(&key, good.data + 8, sizeof key);
    kit_ok(programs_write(dir, key, "not a program", 14, &e), e);
    assert_true(programs_read(dir, key, &other));
    assert_string_equal((const char *)other.data, "not a program");
    assert_true(double_it_compiles(d));
    assert_false(double_it_compiles(d));

    /* Who else may write there may put any code there. */
    assert_int_equal(chmod(path, 0666), 0);
    assert_true(double_it_compiles(d));
    assert_int_equal(chmod(dir, 0777), 0);
    assert_false(programs_folder(dir));
    assert_int_equal(chmod(dir, 0700), 0);
    assert_true(programs_folder(dir));
    buf_free(&good);
    buf_free(&other);
    arena_free(&a);
}

static void test_old_programs_are_removed(void **state)
{
    struct err e = {0};
    struct arena a = {0};
    struct buf b = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], text[33], name[64], **names;
    const time_t now = time(NULL);
    size_t n = 0;
    kit_ok(file_join(dir, kit_tmp, "many", &e), e);
    assert_true(programs_folder(dir));
    for (uint64_t i = 1; i <= PROGRAMS_KEPT + 1; i++) {
        const struct hash128 key = {i, i};
        struct timeval age[2] = {{.tv_sec = now - 1000 + (time_t)i}};
        age[1] = age[0];
        if (i == 5) /* of the month before last */
            age[0].tv_sec = age[1].tv_sec = now - 60 * 86400;
        kit_ok(programs_write(dir, key, &i, sizeof i, &e), e);
        hash_text(key, text);
        snprintf(name, sizeof name, "%s.program", text);
        kit_ok(file_join(path, dir, name, &e), e);
        assert_int_equal(utimes(path, age), 0);
    }
    kit_ok(file_list(dir, NULL, &a, &names, &n, &e), e);
    assert_int_equal(n, PROGRAMS_KEPT); /* without the fifth */
    assert_false(programs_read(dir, (struct hash128){5, 5}, &b));
    assert_true(programs_read(dir, (struct hash128){1, 1}, &b));
    buf_free(&b);
    for (uint64_t i = 0; i < 2; i++) /* now there are more than are kept: the first goes */
        kit_ok(programs_write(dir, (struct hash128){i, 1000}, &i, sizeof i, &e), e);
    assert_false(programs_read(dir, (struct hash128){1, 1}, &b));
    assert_false(programs_read(dir, (struct hash128){2, 2}, &b));
    assert_true(programs_read(dir, (struct hash128){3, 3}, &b));
    buf_free(&b);
    arena_free(&a);
}

/* A child process of its own, because the choice of folder is made once, before the first OpenCL
 * call. */
static void test_reserve_keeps_what_is_large_enough(void **state)
{
    struct dev *d = *state;
    struct err e = {0};
    cl_mem m = NULL, was;
    size_t room = 0, n;
    kit_ok(dev_reserve(d, 256, &m, &room, &e), e);
    assert_int_equal(room, 256);
    was = m;
    kit_ok(dev_reserve(d, 100, &m, &room, &e), e);
    assert_ptr_equal(m, was);
    assert_int_equal(room, 256);
    kit_ok(dev_reserve(d, 4096, &m, &room, &e), e);
    assert_int_equal(clGetMemObjectInfo(m, CL_MEM_SIZE, sizeof n, &n, NULL), CL_SUCCESS);
    assert_int_equal(n, 4096);
    assert_int_equal(dev_reserve(d, (size_t)d->max_alloc_bytes + 1, &m, &room, &e), ERR_LIMIT);
    assert_null(m);
    assert_int_equal(room, 0);
}

static void test_unwritable_cache_is_named(void **state)
{
    pid_t child = fork(); /* touches no OpenCL object of the parent */
    assert_true(child >= 0);
    if (child == 0) {
        struct dev d;
        struct err e = {0};
        setenv("POCL_CACHE_DIR", "/proc/no-such-folder/kernels", 1);
        enum err_code rc = dev_open(NULL, &d, &e);
        _exit(rc == ERR_DEVICE && strstr(e.msg, "/proc/no-such-folder/kernels") ? 0 : 1);
    }
    int status = 0;
    assert_int_equal(waitpid(child, &status, 0), child);
    assert_true(WIFEXITED(status));
    assert_int_equal(WEXITSTATUS(status), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_open_describes_the_device),
        cmocka_unit_test(test_open_by_name),
        cmocka_unit_test(test_build_and_run),
        cmocka_unit_test(test_unset_argument_is_an_error),
        cmocka_unit_test(test_build_error_cites_file_and_line),
        cmocka_unit_test(test_lines_of_all_pieces_are_those_of_files),
        cmocka_unit_test(test_kernels_are_timed_by_name),
        cmocka_unit_test(test_hand_over_without_waiting),
        cmocka_unit_test(test_buffer_limits),
        cmocka_unit_test(test_reserve_keeps_what_is_large_enough),
        cmocka_unit_test_setup_teardown(test_programs_are_kept, kit_tmp_make, kit_tmp_remove),
        cmocka_unit_test_setup_teardown(test_old_programs_are_removed, kit_tmp_make,
                                        kit_tmp_remove),
        cmocka_unit_test(test_unwritable_cache_is_named),
    };
    return cmocka_run_group_tests_name("dev", tests, setup, teardown);
}
