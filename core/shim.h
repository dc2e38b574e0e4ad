/* Keeps C++ exceptions inside the C++ files between a library and C. A function of such a file is a
 * try block:
 *
 *     extern "C" enum err_code draco_encode(..., struct err *e)
 *     try {
 *     }
 *     SHIM_CATCH("draco_encode", ERR_FORMAT)
 *
 * std::bad_alloc becomes ERR_MEM. Another std::exception becomes `code` with its text. Anything
 * else becomes ERR_INTERNAL.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef CORE_SHIM_H
#define CORE_SHIM_H

#ifdef __cplusplus
#include <exception>
#include <new>

#define SHIM_CATCH(who, code)                                                                      \
    catch (const std::bad_alloc &)                                                                 \
    {                                                                                              \
        return err_set(e, ERR_MEM, who ": out of memory");                                         \
    }                                                                                              \
    catch (const std::exception &x)                                                                \
    {                                                                                              \
        return err_set(e, code, who ": %s", x.what());                                             \
    }                                                                                              \
    catch (...)                                                                                    \
    {                                                                                              \
        return err_set(e, ERR_INTERNAL, who ": unknown exception");                                \
    }
#endif

#endif
